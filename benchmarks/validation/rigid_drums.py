"""Cables over a rigid drum: OpenSim's path around a cylinder, and L. Euler's capstan.

OpenSim's `testWrapCylinder.cpp` has the points where a path leaves a cylinder of radius 1 and its
length in between; it was read in its repository. Here a frictionless cable is laid obliquely over a
meshed cylinder and slides to that path, across the cells. The capstan's ratio of tensions, exp(mu
angle), is the textbook formula; a half turn is the root of the factor that is tabulated for one.

    ./run python benchmarks/validation/rigid_drums.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from crms_fenicsx import Cable, Friction, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.foundation.meshes import MembraneMesh
from validation.table import COMM, OURS, PUBLISHED, Row, labels, over_sizes, panels, report, save

ENDS = np.array([(2.0, -2.0), (-2.0, 2.1)])
"""Of the path, in the plane across the cylinder; both ends lie in it."""
LEAVES = np.array([(0.911437827766147, 0.411437827766148), (0.441911556159668, 0.897058624913969)])
WRAPPED = 0.689036814042993
STRAIGHT = float(np.linalg.norm(ENDS[0] - LEAVES[0]) + np.linalg.norm(ENDS[1] - LEAVES[1]))
COEFFICIENTS = (0.1, 0.3, 0.5)
STIFF = IsotropicMembrane(E=1e6, nu=0.3, thickness=1.0, wrinkling=False)


def drum(n: int, middle: float, angle: float, width: float = 1.2) -> MembraneMesh:
    """A part of the cylinder of radius 1 around the x axis, n cells around it, its rows shifted."""
    rows = max(4, round(n * width / angle))
    i, j = np.meshgrid(np.arange(rows + 1), np.arange(n + 1), indexing="ij")
    inner = (i > 0) & (i < rows) & (j > 0) & (j < n)
    shift = inner * 0.25 * np.sin(7.0 * i + 3.0 * j)  # no line of the mesh lies along the path
    x = ((i + shift) / rows - 0.47) * width
    turn = middle + ((j + inner * 0.25 * np.cos(5.0 * i + 2.0 * j)) / n - 0.5) * angle
    points = np.stack([x, np.sin(turn), np.cos(turn)], axis=-1).reshape(-1, 3)
    a = (np.arange(rows)[:, None] * (n + 1) + np.arange(n)).ravel()
    b, c, d = a + n + 1, a + n + 2, a + 1
    cells = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    sides = np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]])
    return meshes.from_arrays(
        COMM, points, cells, edges={"drum": np.unique(np.sort(sides, axis=1), axis=0)},
        outside=meshes.AwayFrom((0.0, 0.0, 0.0)),
    )  # fmt: skip


def wrapped(n: int) -> tuple[float, np.ndarray, np.ndarray]:
    """Length of the cable over the cylinder, its line, and its path at laying.

    The membrane is turned so that the path's middle is on top: x is along the axis.
    """
    corner = np.arctan2(LEAVES[:, 1], LEAVES[:, 0])
    turn = np.pi / 2 - corner.mean()
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    ends = ENDS @ rotation.T
    scene = Scene(drum(n, 0.0, 2.4), STIFF)
    scene.fix("drum")
    t = np.linspace(-1.1, 1.1, 23)[:: int(np.sign(ends[1, 0] - ends[0, 0]))]
    over = np.column_stack(
        [0.25 * np.cos(np.linspace(-np.pi / 2, np.pi / 2, 23)), np.sin(t), np.cos(t)]
    )
    path = np.vstack([(0.0, *ends[0]), over[5:-5], (0.0, *ends[1])])
    cable = scene.lay_cable(Cable(EA=1.0), path, tension=0.01)
    start = cable.line
    Solver(scene).advance()
    return cable.length, cable.line, start


def pulled(n: int, mu: float) -> float:
    """Ratio of the tensions of a rope over half a turn that is pulled until all of it slides."""
    scene = Scene(drum(n, 0.0, np.pi), STIFF)
    scene.fix("drum")
    turn = np.linspace(-np.pi / 2, np.pi / 2, 41)
    path = np.column_stack([np.full(41, 0.03), np.sin(turn), np.cos(turn)])
    path = np.vstack([path[0] - (0, 0, 0.5), path, path[-1] - (0, 0, 0.5)])
    rope = scene.lay_cable(Cable(1000.0, friction=Friction(0.0, along=mu)), path)
    Solver(scene).advance(move={rope.end: (0.0, 0.0, -0.1)})
    return float(rope.tensions[-1] / rope.tensions[0])


def main() -> None:
    """Print the table and draw the picture."""
    sizes = (12, 24, 48)
    lengths = [wrapped(n)[0] for n in sizes]
    whole = STRAIGHT + WRAPPED
    best = lengths[-1] + (lengths[-1] - lengths[-2]) / 3
    bar = abs(lengths[-1] - lengths[-2])
    rows = [Row("OpenSim: length of the path over the cylinder", WRAPPED, best - STRAIGHT, bar,
                "first hand; laid 0.25 radii aside, it slides there")]  # fmt: skip
    ratios = {}
    for mu in COEFFICIENTS:
        ratios[mu] = pulled(40, mu)
        rows.append(Row(f"capstan, half a turn, mu = {mu}: T2 / T1", float(np.exp(mu * np.pi)),
                        ratios[mu], abs(ratios[mu] - pulled(20, mu)), "formula"))  # fmt: skip
    report("rigid drums", rows)
    figure, (left, right) = panels()
    _, line, start = wrapped(24)
    left.plot(start[:, 1], start[:, 0], color="0.6", label="as laid")
    left.plot(line[:, 1], line[:, 0], ".-", color=OURS, markersize=3, label="at rest")
    labels(left, "across the cylinder", "along its axis", "plan of the cable over the cylinder")
    steps = [2.4 / n for n in sizes]
    right.plot(steps, [100 * abs(a / whole - 1) for a in lengths], "o-", color=OURS,
               label="length of the cable")  # fmt: skip
    right.plot(
        steps, 0.5 * (np.array(steps) / steps[0]) ** 2, ":", color=PUBLISHED, label="order 2"
    )
    over_sizes(right, steps)
    labels(right, "size of the cells / radius", "error [%]", "against OpenSim")
    save(figure, "rigid_drums")


if __name__ == "__main__":
    main()
