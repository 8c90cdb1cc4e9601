"""An elastic catenary: the fifth line of MoorPy's `tests/test_catenary.py`.

The figures were read in NREL's repository: forces of a line at both ends, from the equations of the
elastic catenary. Here the line is a chain of bars with its weight in the joints, and the number of
bars is extrapolated. The lines of that file that rest on the sea bed cannot be modelled; of its
fourth line, whose EA is 7.5e7 times its weight, no chain was found.

    ./run python benchmarks/validation/hanging_lines.py
"""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from crms_fenicsx import Bar, Joint, Solver
from validation.cable_nets import empty_scene
from validation.table import OURS, PUBLISHED, THIRD, Row, labels, over_sizes, panels, report, save

LINE = 89.9, 59.2, 130.0, 7.51e8, 881.05
"""Span, rise, length (m), EA (N), weight (N/m)."""
FORCES = 31373.229006023103, -26650.341270116318, -31373.229006023103, -87886.15872988368
"""Horizontal and vertical force at the lower end, then at the upper one (N)."""
NAMES = ("horizontal force at the lower end", "vertical force at the lower end",
         "horizontal force at the upper end", "vertical force at the upper end")  # fmt: skip


def hung(bars: int) -> tuple[np.ndarray, np.ndarray]:
    """Forces on the line at its ends (4,) and positions of its points."""
    span, rise, length, EA, weight = LINE
    scene, part = empty_scene(), length / bars
    t = np.linspace(0.0, 1.0, bars + 1)
    depth = 4 * t * (1 - t) * np.sqrt(3 * length * max(length - np.hypot(span, rise), 0.0) / 8)
    guess = np.column_stack([span * t, 0 * t, rise * t - depth])
    inner = [scene.add_joint(place) for place in guess[1:-1]]
    ends: list[Joint | tuple[float, ...]] = [(0.0, 0.0, 0.0), *inner, (span, 0.0, rise)]
    soft = 10 * weight * length  # a stiff chain from a guessed shape has no way down
    made = [scene.add_bar(Bar(soft, tension_only=True), a, b, L0=part)
            for a, b in pairwise(ends)]  # fmt: skip
    scene.put_joint_load({joint: (0.0, 0.0, -weight * part) for joint in inner}, name="weight")
    solver = Solver(scene)
    solver.advance(load=1.0)
    while soft < EA:
        soft = min(10 * soft, EA)
        scene.set_stiffness(dict.fromkeys(made, soft))
        solver.advance()
    line = np.array([(0.0, 0.0, 0.0), *(joint.position for joint in inner), (span, 0.0, rise)])
    found = []
    for k, bar in ((0, made[0]), (-1, made[-1])):
        way = line[1] - line[0] if k == 0 else line[-2] - line[-1]
        force = bar.force * way / np.linalg.norm(way)
        found += [force[0], force[2] - weight * part / 2]  # half a bar's weight is in the end
    return np.array(found), line


def limit(counts: tuple[int, int] = (40, 80)) -> tuple[np.ndarray, np.ndarray]:
    """Forces extrapolated with order 2, and their last differences."""
    coarse, fine = (hung(n)[0] for n in counts)
    return fine + (fine - coarse) / 3, np.abs(fine - coarse)


def main() -> None:
    """Print the table and draw the picture."""
    forces, bars = limit()
    rows = [Row(f"{name} (N)", value, float(force), float(bar), "first hand, from MoorPy's test")
            for name, value, force, bar in zip(NAMES, FORCES, forces, bars, strict=True)
            ]  # fmt: skip
    report("MoorPy", rows)
    figure, (left, right) = panels()
    counts = (10, 20, 40, 80)
    line = hung(40)[1]
    left.plot(line[:, 0], line[:, 2], ".-", color=OURS, markersize=3)
    errors = [100 * np.abs(hung(n)[0] / FORCES - 1) for n in counts]
    steps = [1 / n for n in counts]
    for k, colour in ((0, OURS), (1, PUBLISHED), (3, THIRD)):
        right.plot(steps, [e[k] for e in errors], "o-", color=colour, label=NAMES[k])
    left.set_aspect("equal")
    labels(left, "x [m]", "z [m]", "chain of 40 bars", legend=False)
    over_sizes(right, steps)
    labels(right, "1 / bars", "error [%]", "convergence")
    save(figure, "hanging_lines")


if __name__ == "__main__":
    main()
