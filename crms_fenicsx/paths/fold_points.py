"""The points of cables on the edges of the mesh, found for those edges that are asked for.

Between two looks at the paths few cables change their nodes, and of all edges few are looked at.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property

from crms_fenicsx.cables.points_on_edges import on_edges
from crms_fenicsx.model.cable_state import CableNode, CableState
from crms_fenicsx.model.crossing import NodeId
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.surface.points import Edge


class NodesOnEdges:
    """Which nodes of cables in tension are on each edge, kept for cables that have not changed."""

    def __init__(self) -> None:
        self._nodes: list[tuple[CableNode, ...]] = []
        self._found: dict[Edge, tuple[NodeId, ...]] = {}

    def of(self, states: Sequence[CableState]) -> Mapping[Edge, Sequence[NodeId]]:
        """Numbers of cables and nodes on each edge, lifted ones too; later calls keep it."""
        nodes = [state.nodes if state.taut else () for state in states]
        before, self._nodes = self._nodes, nodes
        if len(before) != len(nodes):
            before, self._found = [()] * len(nodes), {}
        changed = [c for c, own in enumerate(nodes) if own is not before[c]]
        if not changed:
            return self._found
        found = dict(self._found)
        for c in changed:
            for _, edge in on_edges(before[c]):
                found[edge] = tuple(member for member in found[edge] if member[0] != c)
            for k, edge in on_edges(nodes[c]):
                found[edge] = (*found.get(edge, ()), (c, k))
        self._found = found
        return found


class FoldPoints(Mapping[Edge, Sequence[Array]]):
    """Positions (3,) of the points on each edge that has some, in order, without lifted ones.

    They are those at the time when this is made, whatever becomes of the cables.
    """

    def __init__(self, cables: Sequence[LaidCable], kept: NodesOnEdges) -> None:
        self._states, self._kept = [cable.state for cable in cables], kept
        self._found: dict[Edge, list[Array]] = {}

    def __getitem__(self, edge: Edge) -> Sequence[Array]:
        found = self._found.get(edge)
        if found is None:
            found = self._found[edge] = self._on(edge)
        if not found:
            raise KeyError(edge)
        return found

    @cached_property
    def _nodes(self) -> Mapping[Edge, Sequence[NodeId]]:
        return self._kept.of(self._states)

    def _on(self, edge: Edge) -> list[Array]:
        points = []
        for c, k in self._nodes.get(edge, ()):
            state = self._states[c]
            if not state.lifted[k]:
                points.append((float(state.fractions[k]), c, k, state.positions[k]))
        return [point[3] for point in sorted(points, key=lambda point: point[:3])]

    def __iter__(self) -> Iterator[Edge]:
        return (edge for edge in self._nodes if edge in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)
