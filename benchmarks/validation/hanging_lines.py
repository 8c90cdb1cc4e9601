"""Elastic catenaries: lines of MoorPy's `tests/test_catenary.py`.

The figures were read in NREL's repository: forces of a line at both ends, from the equations of the
elastic catenary. Here a line is a chain of bars with its weight in the joints, and the number of
bars is extrapolated. Lines that rest on the sea bed, the other cases there, cannot be modelled.

    ./run python benchmarks/validation/hanging_lines.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from validation.cable_nets import empty_scene
from validation.table import OURS, PUBLISHED, Row, labels, over_sizes, panels, report, save

from crms_fenicsx import Bar, Joint, Solver

LINES = {
    "4": (400.0, 200.0, 500.0, 7.51e12, 200.0),
    "5": (89.9, 59.2, 130.0, 7.51e8, 881.05),
}
"""By numbers: span, rise, length (m), EA (N), weight (N/m)."""
FORCES = {
    "4": (43694.580989249596, -22365.599350216216, -43694.580989249596, -77634.40064978378),
    "5": (31373.229006023103, -26650.341270116318, -31373.229006023103, -87886.15872988368),
}
"""Horizontal and vertical force at the lower end, then at the upper one (N)."""
NAMES = ("horizontal force at the lower end", "vertical force at the lower end",
         "horizontal force at the upper end", "vertical force at the upper end")  # fmt: skip


def hung(number: str, bars: int) -> tuple[np.ndarray, np.ndarray]:
    """Forces on the line at its ends (4,) and positions of its points."""
    span, rise, length, EA, weight = LINES[number]
    scene, part = empty_scene(), length / bars
    t = np.linspace(0.0, 1.0, bars + 1)
    depth = 4 * t * (1 - t) * np.sqrt(3 * length * max(length - np.hypot(span, rise), 0.0) / 8)
    guess = np.column_stack([span * t, 0 * t, rise * t - depth])
    inner = [scene.add_joint(place) for place in guess[1:-1]]
    ends: list[Joint | tuple[float, ...]] = [(0.0, 0.0, 0.0), *inner, (span, 0.0, rise)]
    made = [scene.add_bar(Bar(EA, tension_only=True), a, b, L0=part)
            for a, b in zip(ends[:-1], ends[1:], strict=True)]  # fmt: skip
    scene.put_joint_load({joint: (0.0, 0.0, -weight * part) for joint in inner}, name="weight")
    Solver(scene).advance(load=1.0)
    line = np.array([(0.0, 0.0, 0.0), *(joint.position for joint in inner), (span, 0.0, rise)])
    found = []
    for k, bar in ((0, made[0]), (-1, made[-1])):
        way = line[1] - line[0] if k == 0 else line[-2] - line[-1]
        force = bar.force * way / np.linalg.norm(way)
        found += [force[0], force[2] - weight * part / 2]  # half a bar's weight is in the end
    return np.array(found), line


def limit(number: str, counts: tuple[int, int] = (40, 80)) -> tuple[np.ndarray, np.ndarray]:
    """Forces extrapolated with order 2, and their last differences."""
    coarse, fine = (hung(number, n)[0] for n in counts)
    return fine + (fine - coarse) / 3, np.abs(fine - coarse)


def main() -> None:
    """Print the table and draw the picture."""
    rows = []
    for number, values in FORCES.items():
        forces, bars = limit(number)
        for name, value, force, bar in zip(NAMES, values, forces, bars, strict=True):
            if name != NAMES[2]:
                rows.append(Row(f"line {number}: {name} (N)", value, float(force), float(bar),
                                "first hand, from MoorPy's test"))  # fmt: skip
    report("MoorPy", rows)
    figure, (left, right) = panels()
    counts = (10, 20, 40, 80)
    for (number, values), mark, colour in zip(FORCES.items(), "os", (OURS, PUBLISHED), strict=True):
        line = hung(number, 40)[1]
        left.plot(line[:, 0], line[:, 2], color=colour, label=f"line {number}")
        errors = [abs(hung(number, n)[0][0] / values[0] - 1) * 100 for n in counts]
        right.plot([1 / n for n in counts], errors, mark + "-", color=colour, label=f"line {number}")
    left.set_aspect("equal")
    labels(left, "x [m]", "z [m]", "chains of 40 bars")
    over_sizes(right, [1 / n for n in counts])
    labels(right, "1 / bars", "error [%]", "horizontal force")
    save(figure, "hanging_lines")


if __name__ == "__main__":
    main()
