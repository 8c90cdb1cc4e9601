"""Combinations that can govern: a mast on guys, whose forces follow by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cabled_square import sheet
from mpi4py import MPI
from report_page import Page, read_csv

from crms_fenicsx import Bar, InputError, Solver, codes, study

TOP, EA = (20.0, 0.0, 6.0), 1e6  # stiff: the forces add up
FEET = {
    "west": (12.0, 0.0, 0.0), "east": (28.0, 0.0, 0.0), "north": (20.0, 8.0, 0.0),
}  # fmt: skip
WAYS = {name: np.subtract(foot, TOP) / np.linalg.norm(np.subtract(foot, TOP))
        for name, foot in FEET.items()}  # fmt: skip
LOADS = {
    "weight": (0.0, 0.0, -4.0), "snow": (0.0, 0.0, -10.0), "snow drifted": (2.0, 0.0, -7.0),
    "wind x": (5.0, 0.0, 2.0), "wind y": (0.0, 6.0, 3.0),
}  # fmt: skip
VARIABLE = [name for name in LOADS if name != "weight"]


def tripod(comm: MPI.Intracomm) -> Solver:
    """Three bars that meet at a loaded joint, beside a sheet."""
    scene = sheet(comm, 2, side=1.0)
    top = scene.add_joint(TOP, name="top")
    for name, foot in FEET.items():
        scene.add_bar(Bar(EA=EA), foot, top, name=name)
    for name, force in LOADS.items():
        scene.put_joint_load({top: force}, name=name)
    solver = Solver(scene)
    solver.advance(load={"weight": 1.0})
    return solver


def by_hand(factors: dict[str, object]) -> dict[str, float]:
    """Forces of the three bars, from the balance of the joint."""
    force = sum(float(factors[name]) * np.array(one) for name, one in LOADS.items())  # type: ignore[arg-type]
    found = np.linalg.solve(np.array([*WAYS.values()]).T, -force)
    return dict(zip(WAYS, found.tolist(), strict=True))


@pytest.mark.ranks
def test_what_is_left_out_governs_nothing(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """For each kind of leading load the largest tension and compression of each bar, by hand, are
    among those of the combinations that are solved; the reasons agree with the forces by hand."""
    solver = tripod(comm)
    table = codes.combinations(codes.en1990, ["weight"], VARIABLE)
    found = study.combine_governing(solver, table)
    kept = next(iter(found.values())).table
    assert kept is not None and len(table) == 26
    assert len(found) < len(table) == len(found) + len(kept.left_out)
    forces = {name: by_hand(one) for name, one in table.items()}
    for name, one in found.items():
        solver.restore(one.snapshot)
        for bar in solver.scene.bars:
            assert bar.force == pytest.approx(forces[name][bar.name], abs=1e-3)
    for kind in ("snow", "wind", ""):
        own = [name for name in table if table.leading(name) == kind]
        for bar in FEET:
            for sign in (1.0, -1.0):
                most = max(sign * forces[name][bar] for name in own)
                solved = max(sign * forces[name][bar] for name in own if name in found)
                assert solved == pytest.approx(most, abs=1e-3)
    for name, why in kept.left_out.items():
        bar, _, rest = why.partition(" estimated at ")
        share, _, rest = rest.partition("% of that in ")
        bar = bar.split()[-1]  # its force, or that on its foot, which is proportional
        by = forces[name][bar] / forces[rest.split(";")[0]][bar]
        assert float(share) == pytest.approx(100.0 * by, abs=0.51)
    _reported(solver, found, tmp_path)


def _reported(solver: Solver, found: dict, tmp_path: Path) -> None:  # type: ignore[type-arg]
    """The report lists the factors, and every combination that was not computed."""
    folder = solver.comm.bcast(tmp_path)
    path = folder / "mast.html"
    solver.report(path, found)
    if solver.comm.rank == 0:
        tables = Page(path.read_text(encoding="utf-8")).tables
        factors = {row[0]: row[1:] for row in tables["Partial and combination factors"][1:]}
        assert factors["weight"][:2] == ["permanent", "1.35 or 1"]
        assert factors["wind y"] == [
            "wind", "1.5", "0.6", "0.2", "0", "EN 1990, table A1.1 and table A1.2(B)"
        ]  # fmt: skip
        (row,) = tables["Combinations by limit state"][1:]
        assert row[:2] == ["ULS", "EN 1990, 6.4.3.2, (6.10), table A1.2(B)"]
        assert row[-2:] == ["26", str(len(found))]
        listed = read_csv(folder / "mast_left_out.csv")
        assert len(listed) == 26 - len(found)


def test_combinations_of_one_setting_each_are_all_solved(comm: MPI.Intracomm) -> None:
    """Missing bars make settings and groups of their own."""
    solver = tripod(comm)
    top = next(one for one in solver.scene.joints if one.name == "top")
    solver.scene.add_bar(Bar(EA=EA), (20.0, -8.0, 0.0), top, name="south")
    solver.advance()
    table = codes.combinations(
        codes.en1990, ["weight"], [], state=["ULS", "accidental"],
        accidents={f"{bar} lost": {"without": [bar]} for bar in ("north", "south")},
    )  # fmt: skip
    found = study.combine_governing(solver, table)
    assert {"accidental: north lost + 1 weight", "accidental: south lost + 1 weight"} <= set(found)


def test_a_table_of_combinations_is_needed(comm: MPI.Intracomm) -> None:
    solver = tripod(comm)
    with pytest.raises(InputError, match="table"):
        study.combine_governing(solver, {"one": {"snow": 1.5}})  # type: ignore[arg-type]
