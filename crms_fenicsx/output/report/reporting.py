"""Reports of a solver's states and combinations of loads, by one call on all ranks."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path

from mpi4py import MPI

from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import collective
from crms_fenicsx.runtime.readonly import ReadOnly
from crms_fenicsx.scene import Scene
from crms_fenicsx.steps.load_cases import Combination
from crms_fenicsx.steps.snapshot import Snapshot


class Reporting:
    """The part of a solver that writes reports."""

    comm: MPI.Intracomm
    _scene: Scene
    scene: ReadOnly[Scene]
    base: Snapshot | None

    @property
    @abstractmethod
    def system(self) -> System:
        """The potential of the scene."""

    @abstractmethod
    def snapshot(self) -> Snapshot:
        """The current state."""

    @abstractmethod
    def restore(self, snapshot: Snapshot) -> None:
        """Bring the scene back to a state."""

    @collective
    def report(
        self,
        filename: str | Path,
        combinations: Mapping[str, Combination] | None = None,
        *,
        title: str = "Membrane structure",
        about: Mapping[str, str] | None = None,
        unit: str = "",
        force: str = "",
        cable_strengths: Mapping[str, float] | None = None,
        pictures: Sequence[str] | None = None,
        view: tuple[float, float] = (-60.0, 30.0),
    ) -> None:
        """Write a report to attach to a calculation: one page of HTML, and CSV tables. Collective.

        The page has the model, combinations, pictures, section forces, utilisation and envelopes,
        cables, bars, ponds, reactions and the verification's verdicts; it loads nothing from
        elsewhere, is smaller than 5 MB, and prints on A4. The tables lie beside it: ``tent.html``
        has ``tent_membrane.csv``, ``tent_cables.csv`` and so on, with all digits. Results are those
        of the states that the combinations led to, with the model and the base state that these
        were brought on with, whatever the scene is now; strengths are the present ones. The scene's
        own state is as before. Without combinations the page says in red if the scene has been
        changed since its last load step. Bars whose names differ in a number at their end, as those
        of a belt, share rows on the page if they are ten or more.

        Parameters
        ----------
        filename
            Of the page, ending in .html. Files that are there are replaced when all are complete.
        combinations
            What `combine` returned; by default the current state alone.
        title
            Heading.
        about
            Names and texts below it: ``{"Project": "...", "Author": "..."}``.
        unit, force
            Names of the units of length and force, for headings.
        cable_strengths
            Strengths of cables by their names, divided by the partial factors (force); those that
            are named get a utilisation. Those of the fabric are `Scene.set_strengths`'s.
        pictures
            What colours the membrane in a picture of each combination, as for `draw`, or "tension",
            that of cables and bars; by default these, displacement, section forces (of fabrics with
            a warp along warp and weft) and, with strengths, utilisation. Where the page would be
            too large, the last ones are left out.
        view
            Where the viewer stands, as for `draw`.

        Raises
        ------
        InputError
            On all ranks and before anything is written: an argument that cannot be used, a file
            that cannot be written, or combinations of models that differ; it says in what.

        Examples
        --------
        >>> found = solver.combine({"snow": {"snow": 1.5}, "storm": {"wind": 1.5}})
        >>> solver.report("results/tent/report.html", found, title="Tent", unit="m", force="kN")
        """
        from crms_fenicsx.output.report.arguments import checked_plan, checked_states
        from crms_fenicsx.output.report.writing import drawn, model_of, results_of, write_report

        listed: object = combinations
        if isinstance(combinations, Mapping):
            listed = dict.fromkeys(combinations)
        checks.same(self.comm, "report", combinations=listed)
        states = checks.in_one_order(self.comm, checked_states(self._scene, combinations))
        plan = checked_plan(
            self.comm, self._scene, filename, title=title, about=about, unit=unit, force=force,
            cable_strengths=cable_strengths, pictures=pictures, view=view,
        )  # fmt: skip
        model, cases = model_of(self, plan, states), results_of(self, states)
        write_report(self, plan, model, drawn(self, plan, states, cases, cases))
