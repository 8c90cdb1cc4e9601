"""Spheres sewn from gores and inflated: radius, and section forces against the intended ones.

A film with E t = 800, nu = 0.3 in gores of a sphere of radius 10, 8 columns of cells each,
compensated for 1.5 along warp and weft, sewn together and inflated by p = 0.3: a quarter, with
planes of symmetry. Without wrinkling the figures can be compared with those of an independent
program, in brackets; with wrinkling, the compression vanishes where the film wrinkles.

First, the energies of single flattened gores, in per cent of that program's limits, and their
outlines, by number of columns of cells.

    ./run python benchmarks/sewn_spheres.py [flat|linear|wrinkling] [GORES ...]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from mpi4py import MPI

from crms_fenicsx import IsotropicMembrane, patterns
from crms_fenicsx.foundation.meshes.triangles import arc_lengths

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "scenes"))
from pattern_surfaces import inflated_sphere, two_gores

LIMITS = {16: 6.94e-3, 32: 4.389e-4, 64: 2.7505e-5}
"""Energies per area of gores laid flat."""

THERE = {
    8: "9.555 to 10.264, 1.438 / 1.96 / -4.3, 1.492 / .27",
    16: "9.918 to 10.064, 1.497 / 1.25 / -2.1, 1.492 / .15",
    32: "9.989 to 10.012, 1.501 / .60 / -.21, 1.498 / .079",
    64: "9.9987 to 10.0015, 1.5002 / .20 / .93, 1.4995 / .028",
    128: "9.9998 to 10.0004, 1.5000 / .056 / 1.34, 1.4999 / .008",
}
"""Radii; along warp mean, standard deviation and least force; along weft mean and deviation."""


def flat(columns: Sequence[int] = (4, 8, 16, 32)) -> None:
    """Print energies of flat gores, widths, and lengths, which the meridian's facets have too."""
    film = IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0)
    for n in columns:
        row = []
        for gores, limit in LIMITS.items():
            mesh = two_gores(MPI.COMM_SELF, gores, n, n * gores // 4)
            pieces = patterns.cut(mesh, [patterns.edge_line(mesh, "seam 1")])
            one = patterns.flatten(pieces, film).flat[0]
            own = one.problem_of(one.piece, one.shape).energy(one.shape) / one.piece.area
            (seam,) = (edge.vertices for edge in one.piece.edges if edge.sewn)
            meridian = arc_lengths(one.piece.points[seam])[-1]
            row.append(
                f"{one.energy / limit:.1%} ({own / limit:.0%} on its own cells), "
                f"{one.length:.5f} x {one.width:.5f}, meridian {meridian:.5f}"
            )
        print(n, *row, sep=" | ", flush=True)


def main(wrinkling: bool, gores: list[int]) -> None:
    """Print a row for each number of gores."""
    for n in gores:
        start = time.process_time()
        solver, pattern, radii = inflated_sphere(MPI.COMM_WORLD, n, wrinkling)
        got = patterns.compare(solver, pattern, 1.5).whole
        print(
            f"{n:4} gores: r {radii.min():.4f} to {radii.max():.4f}, warp {got.mean[0]:.4f} / "
            f"{got.spread[0]:.3f} / {got.least[0]:.3f}, weft {got.mean[1]:.4f} / "
            f"{got.spread[1]:.4f} / {got.least[1]:.3f}, wrinkled {got.wrinkled:.1%}, "
            f"{time.process_time() - start:.0f} s" + ("" if wrinkling else f" ({THERE.get(n)})"),
            flush=True,
        )


if __name__ == "__main__":
    law, *numbers = sys.argv[1:] or ["linear"]
    if law == "flat":
        flat()
    else:
        main(law == "wrinkling", [int(n) for n in numbers] or list(THERE))
