"""Flags of blocks, exchanged between the ranks that know these blocks."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.runtime.arrays import Booleans


class GhostFlags:
    """Exchanges flags of the blocks of a layout, (n_local,). All methods are collective.

    Attributes: `shared` (n_local,): whether a block is known to several ranks.
    """

    def __init__(self, unknowns: Unknowns) -> None:
        self._unknowns = unknowns
        self._vector, self._values = unknowns.vector()
        ghosts = np.arange(unknowns.n_local) >= unknowns.n_owned
        self.shared = self.on_any(ghosts)

    def destroy(self) -> None:
        """Free the PETSc vector."""
        self._vector.destroy()

    def of_owners(self, flags: Booleans) -> Booleans:
        """The owners' flags, on ghosts too."""
        if self._unknowns.comm.size == 1:
            return flags
        self._values[:] = flags[:, None]
        self._unknowns.update_ghosts(self._vector)
        return np.asarray(self._values[:, 0] > 0.0)

    def on_any(self, flags: Booleans) -> Booleans:
        """Whether any rank has set a flag."""
        if self._unknowns.comm.size == 1:
            return flags
        self._values[:] = flags[:, None]
        self._unknowns.add_ghosts(self._vector)
        return self.of_owners(self._values[:, 0] > 0.0)
