"""A circular membrane under a uniform load: W. B. Fichter, NASA TP-3658 (1997).

For small loads H. Hencky's solution: with the load q = p a / (E h) the section force in the centre
over E h is b0/4 q^(2/3) and the rise over a is w0 q^(1/3). For finite loads Fichter's table, of a
load that stays vertical, and of pressure. The figures are second hand: the report was not at hand.

    ./run python benchmarks/validation/fichter.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from crms_fenicsx import IsotropicMembrane, Scene, Solver
from crms_fenicsx.design.study import Convergence
from crms_fenicsx.foundation.meshes import MembraneMesh
from validation.disks import disk, limit, rise
from validation.table import OURS, PUBLISHED, Row, labels, panels, report, save

HENCKY = {0.2: 0.42068, 0.3: 0.43110, 0.4: 0.44423}
"""b0/4 by Poisson's ratio."""
RISE = 0.6534
"""w0, nu = 0.3."""
TABLE = {("vertical load", 0.001): 0.00431, ("vertical load", 0.01): 0.0200,
         ("pressure", 0.01): 0.0207}  # fmt: skip
"""Section force in the centre over E h, nu = 0.3."""
SMALL = 1e-9
REASONS = {0.001: "the strain is 0.003", 0.01: "the strain is 0.014"}


def loaded(mesh: MembraneMesh, q: float, nu: float, kind: str) -> Solver:
    """A disk of radius 1 and E h = 1 under a load."""
    scene = Scene(mesh, IsotropicMembrane(E=1.0, nu=nu, thickness=1.0))
    scene.fix("boundary")
    solver = Solver(scene)
    if kind == "pressure":
        solver.advance(pressure=q)
    else:
        scene.put_load((0.0, 0.0, q), name="load", per="material")
        solver.advance(load=1.0)
    return solver


def centre_force(solver: Solver) -> float:
    """Mean true section force of the cells around the centre."""
    results = solver.results()
    middle = results.surface.points[results.surface.triangles].mean(axis=1)
    nearest = np.hypot(middle[:, 0], middle[:, 1]).argsort()[:6]
    return float(results.true_forces[nearest].mean())


def computed(q: float, nu: float = 0.3, kind: str = "pressure", levels: int = 4) -> Convergence:
    """Section force in the centre and rise of a disk, extrapolated."""
    return limit(lambda mesh: loaded(mesh, q, nu, kind), 1.0, rings=4, levels=levels,
                 quantities={"force": centre_force, "rise": rise})  # fmt: skip


def main() -> None:
    """Print the table and draw the picture."""
    rows, forces = [], {}
    for nu, value in HENCKY.items():
        found = computed(SMALL, nu)
        force, height = found["force"], found["rise"]
        scale = SMALL ** (2 / 3)
        rows.append(Row(f"small load, b0/4, nu = {nu}", value, force.limit / scale,
                        force.bar / scale, "Hencky's solution, second hand"))  # fmt: skip
        if nu == 0.3:
            scale = SMALL ** (1 / 3)
            rows.append(Row("small load, w0, nu = 0.3", RISE, height.limit / scale,
                            height.bar / scale, "Hencky's solution, second hand"))  # fmt: skip
    for (kind, q), value in TABLE.items():
        forces[kind, q] = one = computed(q, kind=kind)["force"]
        rows.append(Row(f"{kind}, p a / E h = {q:g}: force in the centre / E h", value, one.limit,
                        one.bar, f"Fichter's table, second hand; {REASONS[q]}, and his law of "
                        "strain, probably, another one"))  # fmt: skip
    report("Fichter", rows)
    figure, (left, right) = panels()
    solver = loaded(disk(1.0, 16), 0.01, 0.3, "pressure")
    x = solver.scene.positions()
    left.plot(np.hypot(x[:, 0], x[:, 1]), x[:, 2], ".", color=OURS, markersize=3)
    labels(left, "radius / a", "height / a", "pressure, p a / E h = 0.01", legend=False)
    loads = np.geomspace(5e-4, 2e-2, 30)
    right.loglog(loads, HENCKY[0.3] * loads ** (2 / 3), color="0.5", label="small loads (Hencky)")
    for kind, mark in (("vertical load", "s"), ("pressure", "D")):
        ours = {one: force.limit for (of, one), force in forces.items() if of == kind}
        right.plot(list(ours), list(ours.values()), ".", color=OURS)
        theirs = {one: value for (of, one), value in TABLE.items() if of == kind}
        right.plot(list(theirs), list(theirs.values()), mark, color=PUBLISHED, mfc="none",
                   label=f"Fichter, {kind}")  # fmt: skip
    right.plot([], [], ".", color=OURS, label="package")
    labels(right, "p a / E h", "force in the centre / E h", "nu = 0.3")
    save(figure, "fichter")


if __name__ == "__main__":
    main()
