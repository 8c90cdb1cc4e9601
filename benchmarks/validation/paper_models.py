"""The paper's three models: H. Sakai and E. Tachibana, foldable finite elements (in Japanese).

The scan of the paper that we have lacks its figures, and with them the drawings and the measured
curves: there is no published number to compare with. Model 1 is compared with the paper's equations
written out by hand, models 2 and 3 with limits of meshes whose lines follow the cable, or finer.

    ./run python benchmarks/validation/paper_models.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from accuracy.cases import CASES, QUANTITIES, Laws
from accuracy.references import reference

from crms_fenicsx import Cable, IsotropicMembrane, OrthotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.design.study import convergence
from crms_fenicsx.design.study.convergence import Convergence
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.model.materials import MembraneMaterial
from validation.paper_by_hand import Element, Rope, Step, isotropic, orthotropic, raised
from validation.table import (
    COMM,
    OURS,
    PUBLISHED,
    THIRD,
    Row,
    labels,
    over_sizes,
    panels,
    report,
    save,
)

CORNERS = [(0.0, 0.0), (25.0, 60.0), (70.0, 0.0)]
PATH = [(-20.0, 30.0, 0.0), (90.0, 24.0, 0.0)]
LIFT = 12.0
SHEET = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, wrinkling=False)
FABRIC = OrthotropicMembrane(400.0, 200.0, 90.0, 0.2, 0.08, warp=(1.0, 0.0, 0.0), wrinkling=False)
BY_HAND = {
    SHEET: isotropic(300.0, 0.25),
    FABRIC: orthotropic(400.0, 200.0, 90.0, 0.2),
}


def single_element(
    mu: float | None, steps: int = 6, material: MembraneMaterial = SHEET
) -> list[Step]:
    """Model 1 by the package, with the paper's step-wise laws, or its own where mu is None."""
    mesh = meshes.from_arrays(COMM, CORNERS, [(0, 1, 2)], point_groups={"corners": [0, 1, 2]})
    if mu is None:
        scene, cable = Scene(mesh, material), Cable(EA=32000.0)
    else:
        scene = Scene(mesh, material, strain="step", pressure="step", literal_penalty=mu)
        cable = Cable(EA=32000.0, law="step")
    scene.fix("corners")
    laid = scene.lay_cable(cable, path=PATH, hold="sleeve")
    solver, found = Solver(scene), [Step(0.0, laid.line, 0.0)]
    for _ in range(steps):
        solver.advance(move={laid: (0.0, 0.0, LIFT / steps)})
        found.append(Step(laid.tension, laid.line, scene.energy))
    return found


def by_hand(
    mu: float, start: Step, steps: int = 6, material: MembraneMaterial = SHEET
) -> list[Step]:
    """Model 1 by the paper's equations, from the same sliding nodes."""
    corners = np.column_stack([CORNERS, np.zeros(3)])
    element = Element(BY_HAND[material], 0.08)
    return raised(element, Rope(32000.0), np.vstack([corners, start.line]), mu, LIFT, steps)


def farthest(ours: list[Step], theirs: list[Step]) -> float:
    """Largest distance between the nodes of two runs (cm)."""
    pairs = zip(ours, theirs, strict=True)
    return max(float(np.abs(one.line - other.line).max()) for one, other in pairs)


def limits(name: str, n: int, levels: int = 3) -> Convergence:
    """Limits of models 2 and 3."""
    case = CASES[name]

    def build(mesh: MembraneMesh) -> Solver:
        return case.run(mesh, Laws())[0]

    wanted = {q: QUANTITIES[q] for q in "WTzy"}
    return convergence(build, case.mesh(n), levels, quantities=wanted)


def main() -> None:
    """Print the table and draw the picture."""
    rows = []
    for name, material in (("isotropic", SHEET), ("orthotropic", FABRIC)):
        for mu in (1.0, 100.0):
            ours = single_element(mu, material=material)
            theirs = by_hand(mu, ours[0], material=material)
            rows.append(Row(
                f"model 1, {name}, penalty {mu:g} kgf cm: T (kgf)", theirs[-1].tension,
                ours[-1].tension, 0.0, "equations by hand; both sliding nodes within "
                f"{farthest(ours[1:], theirs):.0e} cm in all six steps",
            ))  # fmt: skip
    named = {"T": "T (kgf)", "z": "z of the cable (cm)", "W": "W (kgf cm)", "y": "y (cm)"}
    cases = {"model 2": (9, 3, "zT"), "model 3, smooth": (12, 3, "WT"),
             "model 3, rough": (8, 3, "yT")}  # fmt: skip
    drawn = {}
    for name, (n, levels, quantities) in cases.items():
        drawn[name] = study = limits(name, n, levels)
        for q in quantities:
            known = reference(name, q)
            rows.append(Row(
                f"{name}: {named[q]}", known.value, study[q].limit, study[q].bar,
                f"our reference, +- {known.bar:g}: {known.source}",
            ))  # fmt: skip
    report("the paper", rows)
    draw(drawn["model 2"])


def draw(model_2: Convergence) -> None:
    """Tension of model 1 over the steps; convergence of model 2."""
    figure, (left, right) = panels()
    lifts = np.linspace(0.0, LIFT, 7)
    for mu, colour in ((1.0, OURS), (100.0, PUBLISHED), (None, THIRD)):
        ours = single_element(mu)
        name = "own laws" if mu is None else f"penalty {mu:g}"
        left.plot(lifts, [s.tension for s in ours], color=colour, label=f"package, {name}")
        if mu is not None:
            hand = [0.0, *(s.tension for s in by_hand(mu, ours[0]))]
            left.plot(lifts, hand, "o", color=colour, mfc="none", label=f"by hand, {name}")
    labels(left, "way of the cable's ends [cm]", "tension [kgf]", "model 1")
    sizes = 100.0 / 9 / 2.0 ** np.arange(len(model_2.cells))
    for q, colour in (("T", OURS), ("z", THIRD)):
        exact = reference("model 2", q).value
        errors = [abs(value / exact - 1) for value in model_2[q].values]
        right.plot(sizes, np.multiply(100, errors), "o-", color=colour, label=q)
    right.plot(sizes, 0.4 * (sizes / sizes[0]) ** 2, ":", color="0.5", label="order 2")
    over_sizes(right, sizes)
    labels(right, "size of the cells [cm]", "error [%]", "model 2")
    save(figure, "paper_models")


if __name__ == "__main__":
    main()
