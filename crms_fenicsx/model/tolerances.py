"""Tolerances shared by the modules that lay, attach and move cables.

Except for `SAME_PLACE`, they are fractions of an edge, from one of its ends, in increasing order.
Each exceeds the one before for the reason given, so that modules agree on what a point lies on.
"""

from __future__ import annotations

SAME_PLACE = 1e-9
"""Distance of coinciding points, relative to the size of a cable, the membrane or nearby cells."""

SMOOTHING = 3e-3
"""Smoothing of segment lengths, relative to the size of the surrounding cells. The larger it is,
the faster fold points held at a vertex converge; each lengthens the cable by 0.4 of it, which
`analysis.equilibrium.system.System.renew_smoothing_length` subtracts again."""

BLOCKED = SMOOTHING
"""A sliding point closer to a vertex has run into it; farther away, the vertex does not hold it."""

PRESSED = 2 * SMOOTHING
"""A frictionless point closer to a vertex is held as if on it; beyond, lengths are not smoothed."""

BEYOND = 0.01
"""Start of a path on the other side of a vertex, outside the smoothing; also the distance within
which a vertex beside a crossing holds the path of a geodesic."""

INSIDE = 0.02
"""Distance of points put on an edge from its ends, larger than for paths just past a vertex."""

GRIPPED = 0.025
"""A gripped point closer to a vertex has run into it, including one put on the edge at `INSIDE`."""

STAYS = 0.1
"""Points with friction that a new path would move by at most this keep their position."""

PAST = 0.25
"""Reach beyond an edge's end within which a span is judged by the edge."""
