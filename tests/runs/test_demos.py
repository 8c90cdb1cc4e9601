"""Each demo runs as a reader would run it, from any folder, and leaves what it promises."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from vtu_file import read_vtu

from crms_fenicsx import Solver
from crms_fenicsx.results.foundations import foundations
from crms_fenicsx.results.output import History

ROOT = Path(__file__).parents[2]
PROMISED = {
    "air_dome": (["calm", "storm", "both"], {".": 2}, ["1000"]),
    "cable_net": (["calm", "wind", "both", "paths"], {".": 4}, ["3.0"]),
    "air_hall": (["operation", "storm", "both"], {".": 9}, ["6.0"]),
    "code_loads": (["fabric", "cable", "both"], {".": 23}, ["1.4"]),
    "clamped_net": (["sliding", "clamped", "both"], {"sliding": 2, "clamped": 2}, ["6.0"]),
    "net_tuning": (["tuned"], {".": 4}, ["6.0"]),
    "patterns": (["roll", "built"], {".": 2}, ["6.0"]),
    "capstan": (["taken_in", "let_out", "profile", "both"], {".": 10}, ["1.6"]),
    "friction_experiment": (
        ["smooth", "rough", "both", "along", "curves"],
        {"smooth": 15, "rough": 15},
        ["10"],
    ),
    "inflated_square": (["inflated", "tightened", "both", "history"], {".": 10}, []),
    "own_term": (["tied_down"], {".": 2}, []),
    "paper": (
        [f"model_{k}_{run}" for k in (1, 2, 3) for run in ("paper", "default")]
        + ["model_2_paper_inflated", "model_2_default_inflated", "curves"],
        {"model_1_paper": 6, "model_2_paper": 10, "model_3_paper_0.7": 15, "model_3_default_0": 15},
        ["10"],
    ),
    "single_element": (["up", "down", "sliding_nodes"], {"up": 6, "down": 6}, []),
    "sliding_cable": (["paths", "inflated", "both"], {".": 6}, []),
    "tent": (["form", "snow", "uplift"], {".": 9}, ["0.84"]),
    "wind_coupling": (["roof"], {}, []),
}
"""By demo: its pictures, the folders of its runs with their numbers of steps, and arguments that
make it fast."""


def test_every_demo_is_tested() -> None:
    assert {path.stem for path in (ROOT / "demos").glob("*.py")} == set(PROMISED)


DENTED = pytest.mark.filterwarnings("ignore::crms_fenicsx.SnapThroughWarning")
"""On cells of 6 m the hall dents all at once under snow."""


MARKS = {"air_hall": [DENTED]}


@pytest.mark.ranks
@pytest.mark.parametrize("demo", [pytest.param(one, marks=MARKS.get(one, [])) for one in PROMISED])
def test_demo(
    comm: MPI.Intracomm,
    demo: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """On any number of ranks, of which the first says each line once and the others nothing."""
    from matplotlib.image import imread

    pictures, runs, arguments = PROMISED[demo]
    monkeypatch.chdir(folder)
    script = str(ROOT / "demos" / f"{demo}.py")
    kernel = ["ipykernel_launcher.py", "-f", str(folder / "kernel.json")]  # of a notebook
    monkeypatch.setattr(sys, "argv", [*kernel, *arguments])
    left = runpy.run_path(script, run_name="__main__")
    for solver in (one for one in left.values() if isinstance(one, Solver)):
        assert foundations(solver.system).unbalanced < 1e-8
    said, errors = capfd.readouterr()
    lines = [line for line in said.splitlines() if line]
    assert errors == "" and len(set(lines)) == len(lines)
    assert ("tension" in said) if comm.rank == 0 else not said
    if comm.rank > 0:
        return

    results = folder / "results" / demo
    assert {path.stem for path in results.glob("*.png")} == set(pictures)
    for name in pictures:
        image = np.asarray(imread(results / f"{name}.png"), dtype=float)[..., :3]
        assert min(image.shape[:2]) > 250
        assert 0.03 < (image < 0.93).any(axis=-1).mean() < 0.9
    for run, steps in runs.items():
        history = History.read(results / run / "history.csv")
        assert len(history) == steps
        assert np.isfinite(history["energy"]).all()
        for series in ("surface", "cables"):
            text = (results / run / f"{series}.pvd").read_text()
            files = [piece.split('"')[0] for piece in text.split('file="')[1:]]
            assert files
            for file in files:
                assert len(read_vtu(results / run / file).points) > 0
