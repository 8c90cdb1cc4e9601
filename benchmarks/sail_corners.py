"""Order of convergence of flat sails whose edge cables meet at corners of 10 to 170 degrees.

Random sails of three to five sides between arcs of radius T / s, every second cable with a
prescribed length; the first sails have a corner of 10 and one of 170 degrees. Fitted orders of the
area, the tensions found and the reactions over three meshes: halved ones ("nested"), and gmsh's,
generated anew on each level, where the whole number of links of a side does not halve as the mesh
size does: "links" fits the area's order to their lengths instead. The last columns are the order in
area of the exact polygons with as many links, fitted to the mesh size, and the largest difference
of an area from that of these polygons, relative to the area's error.

    ./run python benchmarks/sail_corners.py [SAILS]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from scipy.optimize import brentq

from crms_fenicsx import meshes
from crms_fenicsx.design.form_finding import FormCable, FoundForm, find_form
from crms_fenicsx.foundation.meshes import MembraneMesh

S, SIZES, ENOUGH = 2.0, np.array([0.8, 0.4, 0.2]), 1.8


@dataclass(frozen=True)
class Sail:
    """Corners (k, 2), counterclockwise, and half the angles (k,) of the arcs between them."""

    corners: np.ndarray
    halves: np.ndarray

    @property
    def chords(self) -> np.ndarray:
        """From each corner to the next, (k, 2)."""
        return np.roll(self.corners, -1, axis=0) - self.corners

    @property
    def angles(self) -> np.ndarray:
        """Angles (degrees) between the arcs at the corners, (k,)."""
        way = np.arctan2(*self.chords.T[::-1])
        inner = (np.pi - (way - np.roll(way, 1))) % (2 * np.pi)
        return np.degrees(inner - self.halves - np.roll(self.halves, 1))

    @property
    def radii(self) -> np.ndarray:
        """Radii of the arcs, (k,)."""
        return np.linalg.norm(self.chords, axis=1) / 2 / np.sin(self.halves)

    def area(self, segments: np.ndarray) -> float:
        """Area without the segments (k,) between chords and cables."""
        x, y = self.corners.T
        return float((x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2 - segments.sum())

    def reactions(self) -> np.ndarray:
        """Forces on the corners, (k, 2)."""
        way = np.arctan2(*self.chords.T[::-1])
        first, last = way + self.halves, way - self.halves
        pull = S * self.radii[:, None] * np.stack([np.cos(first), np.sin(first)], 1)
        back = S * self.radii[:, None] * np.stack([np.cos(last), np.sin(last)], 1)
        return np.roll(back, 1, axis=0) - pull

    def polygons(self, links: np.ndarray) -> float:
        """Area within equal links in equilibrium, as many on each side as given."""
        segments = []
        for k, n in enumerate(links):
            chord, radius = np.linalg.norm(self.chords[k]), self.radii[k]
            length = 2 * radius * self.halves[k]

            def gap(turn: float, k: int = k, n: int = n, ratio: float = length / chord) -> float:
                if k % 2:
                    return float(n * np.sin(turn / 2) / np.sin(n * turn / 2) - ratio)
                wide = 2 * self.radii[k] / np.cos(turn / 2) * np.sin(n * turn / 2)
                return float(wide - np.linalg.norm(self.chords[k]))

            turn = brentq(gap, 1e-6, np.pi / n)
            outer = chord / 2 / np.sin(n * turn / 2)
            segments.append(outer**2 / 2 * (n * np.sin(turn) - np.sin(n * turn)))
        return self.area(np.array(segments))


def sails(count: int) -> list[Sail]:
    """One with a corner of 10 degrees, one with one of 170, and random ones."""
    kite = np.array([[0.0, 0.0], [10.0, -3.0], [12.0, 0.0], [10.0, 3.0]])
    blunt = np.array([[0.0, 0.0], [5.0, -0.25], [10.0, 0.0], [9.0, 7.0], [1.0, 7.0]])
    first = (np.degrees(2 * np.arctan(0.3)) - 10.0) / 2
    level = (180.0 - 2 * np.degrees(np.arctan(0.05)) - 170.0) / 2
    found = [
        Sail(kite, np.radians([first, 10.0, 10.0, first])),
        Sail(blunt, np.radians([level, level, 20.0, 15.0, 20.0])),
    ]
    random = np.random.default_rng(7)
    while len(found) < count:
        k = random.integers(3, 6)
        turns = np.sort(random.uniform(0, 2 * np.pi, k))
        ring = np.stack([6 * np.cos(turns), 6 * random.uniform(0.6, 1) * np.sin(turns)], 1)
        one = Sail(ring, np.radians(random.uniform(4.0, 35.0, k)))
        if (one.angles.min() > 10 and one.angles.max() < 170
                and np.linalg.norm(one.chords, axis=1).min() > 3):  # fmt: skip
            found.append(one)
    return found


def found_on(mesh: MembraneMesh, sail: Sail) -> FoundForm:
    """The form: tensions of even cables, lengths of odd ones are prescribed."""
    cables = []
    for k, (radius, half) in enumerate(zip(sail.radii, sail.halves, strict=True)):
        law = {"length": 2 * radius * half} if k % 2 else {"tension": S * radius}
        cables.append(FormCable(f"side {k + 1}", **law))
    return find_form(mesh, S, fixed=[f"corner {k + 1}" for k in range(len(cables))], cables=cables)


def measure(sail: Sail, nested: bool) -> tuple[np.ndarray, np.ndarray, float]:
    """Orders (3,) of area, tensions, reactions; (2,) by links, of polygons; distance from these."""
    arcs = sail.radii**2 * (sail.halves - np.sin(2 * sail.halves) / 2)
    exact, pulls, forces = sail.area(arcs), S * sail.radii, sail.reactions()
    errors, ideal, away, lengths = [], [], [], []
    mesh = meshes.polygon(MPI.COMM_WORLD, sail.corners, SIZES[0])
    for level, size in enumerate(SIZES):
        if level:
            mesh = meshes.refine(mesh) if nested else meshes.polygon(mesh.comm, sail.corners, size)
        form = found_on(mesh, sail)
        links = np.array([len(cable.path) - 1 for cable in form.cables])
        tension = np.array([cable.tension for cable in form.cables]) / pulls - 1
        found = np.array([form.reactions[f"corner {k + 1}"][:2] for k in range(len(links))])
        errors.append((
            abs(form.area / exact - 1), np.abs(tension).max(),
            np.linalg.norm(found - forces, axis=1).max() / np.linalg.norm(forces, axis=1).max(),
        ))  # fmt: skip
        link = np.linalg.norm(sail.chords, axis=1) / links
        lengths.append(np.sqrt(np.average(link**2, weights=sail.halves)))
        within = sail.polygons(links)
        ideal.append(abs(within / exact - 1))
        away.append(abs(form.area - within) / abs(form.area - exact))

    def order(values: object, sizes: object = SIZES) -> np.ndarray:
        return np.polyfit(np.log(np.array(sizes)), np.log(np.array(values)), 1)[0]

    area = [error[0] for error in errors]
    return order(errors), np.array([order(area, lengths), order(ideal)]), max(away)


def main() -> None:
    """Print the table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 30
    heads = ("area", "tension", "reaction", "links", "polygons", "distance")
    print(f"{'meshes':9} {'corners [degrees]':25}" + "".join(f"{head:>9}" for head in heads))
    for kind in ("nested", "gmsh"):
        good = 0
        for sail in sails(count):
            orders, others, away = measure(sail, kind == "nested")
            good += bool((orders >= ENOUGH).all())
            angles = " ".join(f"{angle:.0f}" for angle in sail.angles)
            figures = "".join(f"{one:9.2f}" for one in (*orders, *others))
            below = "" if (orders >= ENOUGH).all() else " below"
            print(f"{kind:9} {angles:25}{figures}{away:9.1e}{below}", flush=True)
        print(f"{good} of {count} have orders of {ENOUGH} or more")


if __name__ == "__main__":
    main()
