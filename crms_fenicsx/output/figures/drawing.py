"""Pictures of a solver's scene, as a method of the solver."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.output.figures.scene import draw

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Drawing:
    """The part of a solver that draws its scene."""

    comm: MPI.Intracomm

    @property
    @abstractmethod
    def system(self) -> System:
        """The potential of the scene."""

    def draw(self, filename: str | Path | None = None, **options: Any) -> Figure | None:
        """Draw the scene in its current state, as `crms_fenicsx.output.draw`. Collective.

        Parameters
        ----------
        filename
            Picture to write; its suffix (.png, .pdf, .svg ...) says the format. None returns it.
        **options
            As for `draw`: ``colour``, ``unit``, ``force``, ``ghost``, ``view`` ...

        Returns
        -------
        matplotlib.figure.Figure
            On the first rank, without a file; a notebook shows it. Else None.

        Raises
        ------
        InputError
            On all ranks: an unknown colour or option, or a file that cannot be written.

        Examples
        --------
        In a notebook:

        >>> solver.draw(colour="warp", unit="m", force="kN")
        """
        return draw(self, filename, **options)
