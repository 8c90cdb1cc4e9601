"""Where joints and the vertices at ends of bars are in a layout.

There are few bars compared to vertices: the first rank owns all joints and computes all bars, and
knows their vertices. All ranks know all joints, so that cables can end at them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dolfinx import fem

from crms_fenicsx.dofs.layout import Unknowns, vertex_starts
from crms_fenicsx.runtime.arrays import Array, Indices


class FrameBlocks:
    """Blocks of joints and vertices.

    Attributes: `joint_blocks` (n,): local blocks of the joints; from `layout` on; `vertex_blocks`
    (m,): those of the vertices, on the first rank; -1 on others. Shapes and units: names, joints
    (n,) (length), homes, places (m, 2) (length).
    """

    def __init__(
        self,
        names: Sequence[str],
        joints: Array,
        homes: Sequence[tuple[int, int]],
        places: Array,
    ) -> None:
        self._number = {name: k for k, name in enumerate(names)}
        self.joints, self._homes, self._places = joints, homes, places

    def block(self, joint: str) -> int:
        """Local block of a joint."""
        return int(self.joint_blocks[self._number[joint]])

    def layout(
        self,
        V: fem.FunctionSpace,
        owned: int = 0,
        ghosts: Sequence[tuple[int, int]] = (),
        far: Sequence[tuple[int, int]] = (),
        of_first: int = 0,
    ) -> Unknowns:
        """A layout with joints and vertices beside the points of cables. Collective."""
        rank, n = V.mesh.comm.rank, len(self.joints)
        starts = vertex_starts(V)
        joints = [(0, of_first + k) for k in range(n)]
        local = np.full(len(self._homes), -1, dtype=np.int32)
        further = list(far)
        if rank == 0 and self._homes:
            numbers = [starts[owner] + dof for owner, dof in self._homes]
            local[:] = V.dofmap.index_map.global_to_local(np.array(numbers, dtype=np.int64))
            absent = [home for home, own in zip(self._homes, local, strict=True) if own < 0]
            further += [home for home in dict.fromkeys(absent) if home not in further]
        mine, others = (n, []) if rank == 0 else (0, joints)
        unknowns = Unknowns(V, owned + mine, [*ghosts, *others], further)
        points = unknowns.owned_point_blocks() if rank == 0 else unknowns.ghost_point_blocks()
        self.joint_blocks: Indices = points[len(points) - n :]
        unknowns.X[self.joint_blocks] = self.joints
        self.vertex_blocks: Indices = np.append(unknowns.vertex_blocks(), np.int32(-1))[local]
        blocks = unknowns.far_vertex_blocks()
        for k, home in enumerate(self._homes):
            if rank == 0 and local[k] < 0:
                self.vertex_blocks[k] = blocks[further.index(home)]
                unknowns.X[self.vertex_blocks[k]] = self._places[k]
        return unknowns
