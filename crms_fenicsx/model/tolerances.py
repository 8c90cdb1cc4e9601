"""How near is near: what the modules that lay, hold and move cables take for one place.

Parts of an edge, from an end of it; the least first. Each is larger than the one before for the
reason given, so that what one module has placed is not taken for something else by another.
"""

from __future__ import annotations

SAME_PLACE = 1e-9
"""Distance, relative to a cable's length or to the size of the membrane or of the cells around, of
points that were given as one place."""

SMOOTHING = 3e-3
"""Lengths of segments are smoothed by this part of the size of the cells around. Fold points that
are held at a vertex converge the faster the larger it is, and lengthen the cable by 0.4 of it each;
that is taken off again, see `crms_fenicsx.equilibrium.system.System.renew_smoothing_length`."""

BLOCKED = SMOOTHING
"""A sliding point nearer than this has run into the vertex. Farther off nothing but the cable and
the membrane holds it."""

PRESSED = 2 * SMOOTHING
"""A point without friction nearer than this is held by the vertex as if it were on it: beyond,
lengths are exact, and it slides freely."""

BEYOND = 0.01
"""Where a path starts on the other side of a vertex, off the smoothing; and from where on a vertex
beside a crossing holds the path that a geodesic would take."""

INSIDE = 0.02
"""Points that are put on an edge keep off its ends by this, more than those of a path that has just
passed the vertex."""

GRIPPED = 0.025
"""A point as near as this, to which friction lets it slide, has run into the vertex: also one that
was put on the edge at `INSIDE`."""

STAYS = 0.1
"""By how much a point of a cable with friction may have to move on a new path, and still stays
where it was: others are those that are put back in place."""

PAST = 0.25
"""Up to here a span that passes beyond an edge's end is judged by it; see `contact.lift_off`."""
