"""The arguments of a report, checked, and its files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

from crms_fenicsx.model.materials import OrthotropicMembrane
from crms_fenicsx.output.figures.axes3d import check_view
from crms_fenicsx.output.figures.draw_scene import COLOURS
from crms_fenicsx.output.report.case import TENSION
from crms_fenicsx.output.report.results_tables import Units
from crms_fenicsx.output.report.sections import Report
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import InputError, raised_together
from crms_fenicsx.runtime.files import absolute, make_writable, replaced
from crms_fenicsx.scene import Scene
from crms_fenicsx.steps.load_cases import Combination


@dataclass(frozen=True)
class Plan:
    """What a report is to be: the arguments of `Reporting.report`, checked."""

    path: Path  # of the page
    title: str  # title, about: heading, and names and texts below it
    about: dict[str, str]
    units: Units  # names of the units
    cable_strengths: dict[str, float]  # by the cables' names (force)
    colours: tuple[str, ...]  # of the pictures
    look: dict[str, Any]  # options of `draw` that all pictures have


def checked_plan(
    comm: MPI.Intracomm,
    scene: Scene,
    filename: str | Path,
    *,
    title: str = "Membrane structure",
    about: Mapping[str, str] | None = None,
    unit: str = "",
    force: str = "",
    cable_strengths: Mapping[str, float] | None = None,
    pictures: Sequence[str] | None = None,
    view: tuple[float, float] = (-60.0, 30.0),
) -> Plan:
    """Check the arguments of a report. Collective on `comm`."""
    checks.same(
        comm, "report", filename=filename, title=title, about=about, unit=unit, force=force,
        cable_strengths=cable_strengths, pictures=pictures, view=view,
    )  # fmt: skip
    title, about = checked_labels(title, about, unit, force)
    strengths = checked_cable_strengths(scene, cable_strengths)
    colours = checked_pictures(scene, pictures)
    check_view(view)
    path = checked_path(comm, filename)  # last, as it makes the folder
    look = {"unit": unit, "force": force, "view": view}
    return Plan(path, title, about, Units(unit, force), strengths, colours, look)


def checked_path(comm: MPI.Intracomm, filename: str | Path) -> Path:
    """Path of a page that can be written. Collective."""
    path = absolute(checks.file("report: filename", filename), comm)
    with raised_together(comm):
        if comm.rank == 0:
            check_path(path)
    return path


def checked_states(
    scene: Scene, combinations: Mapping[str, Combination] | None
) -> dict[str, Combination]:
    """Combinations of a scene; none for its current state."""
    if combinations is None:
        return {}
    if not isinstance(combinations, Mapping) or not combinations:
        raise InputError(
            f"report: combinations = {combinations!r}; give what solver.combine(...) returned, or "
            "leave it out for the current state."
        )
    for name, one in combinations.items():
        if not isinstance(one, Combination):
            raise InputError(
                f"report: combination {name!r} is {one!r}; give what solver.combine(...) returned."
            )
        if one.snapshot.scene is not scene:
            raise InputError(
                f"report: combination {name!r} is of another scene; let the solver that made it "
                "write the report."
            )
    return {str(name): one for name, one in combinations.items()}


def checked_labels(
    title: str, about: Mapping[str, str] | None, unit: str, force: str
) -> tuple[str, dict[str, str]]:
    """Title and texts below it."""
    for name, value in (("title", title), ("unit", unit), ("force", force)):
        if not isinstance(value, str):
            raise InputError(f"report: {name} = {value!r} is no text; give one, or ''.")
    about = {} if about is None else about
    if not isinstance(about, Mapping) or not all(
        isinstance(text, str) for pair in about.items() for text in pair
    ):
        raise InputError(
            f"report: about = {about!r}; write texts by names, as in "
            '{"Project": "Tent", "Author": "..."}.'
        )
    return title, dict(about)


def checked_cable_strengths(
    scene: Scene, strengths: Mapping[str, float] | None
) -> dict[str, float]:
    """Strengths of cables by their names (force)."""
    strengths = {} if strengths is None else strengths
    if not isinstance(strengths, Mapping):
        raise InputError(
            f"report: cable_strengths = {strengths!r}; write forces by the cables' names, as in "
            '{"ridge": 120.0}.'
        )
    for name in strengths:
        scene.cable(name)
    return {
        name: checks.positive(f"report: strength of the cable {name!r}", value)
        for name, value in strengths.items()
    }


def checked_pictures(scene: Scene, pictures: Sequence[str] | None) -> tuple[str, ...]:
    """What colours the membrane in pictures."""
    has = bool(scene.membrane.strengths)
    if pictures is None:
        woven = any(isinstance(x, OrthotropicMembrane) for x in scene.materials.values())
        forces = ("warp", "weft") if woven else ("stress",)
        lines = (TENSION,) if scene.cables or scene.bars else ()
        return (*lines, "displacement", *forces, *(("utilisation",) if has else ()))
    if isinstance(pictures, str) or not isinstance(pictures, Sequence):
        raise InputError(f'report: pictures = {pictures!r}; write a list, as in ["stress"].')
    for colour in pictures:
        if colour not in (TENSION, *COLOURS):
            raise InputError(
                f"report: pictures has {colour!r}, which is not known; use some of "
                f"{[TENSION, *COLOURS]}."
            )
        if colour == "utilisation" and not has:
            raise InputError(
                "report: pictures has 'utilisation', but there are no strengths; call "
                "scene.set_strengths(...) before."
            )
    return tuple(pictures)


def check_path(path: Path) -> None:
    """Refuse a path that no report can be written to; not collective."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"report: filename = {str(path)!r} is no page; give one with .html.")
    if path.is_dir():
        raise InputError(f"report: {path} is a folder; give the name of a file in it.")
    make_writable(path.parent)


def write(path: Path, report: Report) -> list[Path]:
    """Write a report's page and its tables; not collective.

    All of them are complete before the first takes the place of one that is there. Returns the
    files.
    """
    texts = {path: report.html()}
    for table in report.tables():
        texts[path.with_name(f"{path.stem}_{table.name}.csv")] = table.csv()
    with ExitStack() as files:
        for file, text in texts.items():
            files.enter_context(replaced(file)).write_text(text, encoding="utf-8")
    return list(texts)
