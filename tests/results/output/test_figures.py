"""Pictures without a file are returned, and show in a notebook what a file would."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cabled_square import CABLE, sheet
from matplotlib.figure import Figure
from matplotlib.image import imread
from mpi4py import MPI

from crms_fenicsx import InputError, Solver
from crms_fenicsx.results.output import Line, draw, draw_history, draw_path, draw_paths, draw_shape

pytestmark = pytest.mark.usefixtures("comm")
COMM = MPI.COMM_WORLD
WAY = Line([[0.0, 0.0, 0.0], [9.0, 9.0, 0.0]])
CORNERS, TRIANGLE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5]], [[0, 1, 2]]


@cache
def tightened() -> Solver:
    scene = sheet(COMM, 4)
    scene.lay_cable(CABLE, [(0.0, 45.0), (100.0, 52.0)], name="ridge", L0=99.5)
    solver = Solver(scene)
    solver.advance(pressure=0.01)
    return solver


Draw = Callable[..., Figure | None]
DRAWN: dict[str, Draw] = {
    "method": lambda *file, **dpi: tightened().draw(*file, colour="stress", unit="cm", **dpi),
    "scene": lambda *file, **dpi: draw(tightened(), *file, ghost=True, **dpi),
    "paths": lambda *file, **dpi: draw_paths(tightened().scene, *(file or [None]), [WAY], **dpi),
    "history": lambda *file, **dpi: draw_history(tightened().history, *file, **dpi),
}
ON_ONE_RANK: dict[str, Draw] = {
    "shape": lambda *file, **dpi: draw_shape(*(file or [None]), CORNERS, TRIANGLE, **dpi),
    "path": lambda *file, **dpi: draw_path(*(file or [None]), [WAY], **dpi),
}


@pytest.mark.ranks
@pytest.mark.parametrize("name", [*DRAWN, *ON_ONE_RANK])
def test_a_figure_shows_what_a_file_has(tmp_path: Path, name: str) -> None:
    file = Path(COMM.bcast(str(tmp_path))) / "drawn.png"
    if name in ON_ONE_RANK and COMM.rank > 0:
        return
    call = {**DRAWN, **ON_ONE_RANK}[name]
    assert call(file, dpi=100) is None
    figure = call()
    assert (figure is None) == (COMM.rank > 0)
    if figure is not None:
        assert isinstance(figure, Figure)
        shown = imread(io.BytesIO(figure._repr_png_()))  # type: ignore[attr-defined]
        np.testing.assert_array_equal(shown, imread(file))


def test_pictures_of_a_notebook_leave_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Path(COMM.bcast(str(tmp_path)))
    monkeypatch.chdir(folder)
    tightened().draw()
    COMM.barrier()
    assert list(folder.iterdir()) == []
    with pytest.raises(InputError, match="filename = 3 is not a path"):
        tightened().draw(3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="colour = 'heat' is not known"):
        tightened().draw(colour="heat")
