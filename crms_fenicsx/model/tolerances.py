"""The numbers that decide in which of several states a load step ends, or what is refused.

None is a property of cloth, rope or air: they belong to the discretisation, a membrane of cells
with cables along its edges and across them. `docs/theory/constants.md` says what becomes of random
scenes when each is halved and doubled.
"""

from __future__ import annotations

from dataclasses import dataclass

SAME_PLACE = 1e-9
"""Distance of coinciding points, relative to the size of a cable, the membrane or nearby cells."""
SAME_POINT = 1e-6
"""The same of points that are drawn, or found by iteration, relative to a line, edge or step."""
LEAST_WEIGHT = 1e-6
"""Least weight of an edge's end, or of a cell's corner, at a point that must lie inside."""
SAME_VALUE = 1e-7
"""Relative difference of results due to the solver's tolerance, or to rounding on another number of
processes. A state with less energy by this part of the sum of all kinds is another one, or has
another arrangement of crossings: rough states of the same arrangement differ by less."""
UNSTRAINED = 1e-12
"""Strain that counts as zero. At it the tangent of a membrane is that of the taut one, whatever the
sign of rounding errors, and cables are slack; smaller loads and prestresses count as none."""


@dataclass(frozen=True)
class Discretisation:
    """Where cables lie, touch and stick on a membrane of cells.

    Heights, depths and movements are relative to the size of the cells there, unless said
    otherwise; forces to the cable's tension; angles are in radians.
    """

    # Fractions of an edge, from one of its ends, in increasing order. Each exceeds the one before
    # for the reason given, so that modules agree on what a point lies on.
    smoothing: float = 3e-3
    """Smoothing of segment lengths. A sliding point closer to a vertex has run into it; farther
    away, the vertex does not hold it. The larger it is, the faster fold points held at a vertex
    converge; each lengthens the cable by 0.4 of it, which
    `analysis.equilibrium.system.System.renew_smoothing_length` subtracts again."""
    beyond: float = 0.01
    """Start of a path on the other side of a vertex, outside the smoothing; also the distance
    within which a vertex beside a crossing holds the path of a geodesic."""
    inside: float = 0.02
    """Distance of points put on an edge from its ends, larger than for paths just past a vertex;
    and weight by which a crossing must have left its cell to be in another."""
    beside_vertex: float = 0.05
    """Distance from a vertex within which a sliding cable may pass it on the other side."""
    stays: float = 0.1
    """Points with friction that a new path would move by at most this keep their position; and a
    cable whose anchor moves aside by at most this in a step keeps its path."""
    reach: float = 0.125
    """Distance beyond an edge's end within which a span is judged by the edge; and height above the
    membrane up to which a cable beside a crossing may touch it."""

    contact: float = 1e-6
    """Outward force above which a contact is released, depth below the membrane at which a cable
    touches down, and lateral pull beyond friction above which a cable may pass a vertex."""
    touching: float = 0.05
    """Height above the membrane up to which a cable may touch it once it has folded it, as folds
    bulge; and gap between crossing cables, relative to their segments there, up to which a clamp
    closes it: before equilibrium cables lie on cells that the others will fold."""
    sunk: float = 0.02
    """Depth below the membrane that exceeds any discretisation error."""
    collapsed: float = 0.5
    """Length of a chord, relative to that on unfolded cells, below which its cable is caught."""
    oblique: float = 0.1
    """Sine of the smallest angle of a crossing; below it cables run side by side. A cable's force
    on an edge that it crosses at a smaller one is along the edge's normal, not across both."""

    nearly_taut: float = 2e-3
    """Relative excess length up to which a cable still counts as taut at first."""
    bulge: float = 1.2
    """The same where folds bulge: factor of the squared mean turn at nodes. On meshes with 9 cells
    along a side, cables keep some tension up to a factor of 1.0."""
    most_bulge: float = 0.02
    """The largest such excess length."""
    slight: float = 1e-4
    """Change of length, relative to the length, that does not count: a cable that has moved by less
    keeps its rejected paths, and first sticks with the force of this strain; a guy with less slack
    counts as taut, as a mast that shortens under its load slackens guys without prestress."""

    sliding: float = 0.05
    """Slip in a load step, relative to that which mobilises friction, above which a node slides;
    and excess of a pull over friction, relative to its bound, for a cable to pass a vertex: with
    less, noise would trigger an avalanche where the static coefficient is larger; with much more
    sliding starts late."""
    bound_rise: float = 1e-3
    """Rise of the tension for bounds of friction to grow: an idle cable's smoothing gives less."""
    bent_pull: float = 0.5
    """Lateral pull of a fold point beyond the friction force, relative to its bound, that only a
    bent edge can carry. From 0.2 to 1 the choice does not count on 20 meshes of a cylinder."""

    uneven: float = 0.02
    """Lateral pull of a run without friction, relative to the normal force, that is not counted:
    different cells on both sides cause such forces, which vanish with the cell size, and edges that
    the penalty straightens hold fold points slightly."""
    kink: float = 0.05
    """Angle that counts as a turn: of a folded edge, above which its cable is laid again, and above
    three times which a state is rejected if fold points have approached each other; of a path along
    mesh lines, which leaves a vertex if it turns there before the cable has pressed a crease into
    the membrane; of a cable beside a crossing, which a kink of an edge holds if it turns more
    within the membrane.

    Fold points on two edges with a common vertex can approach each other away from it: their chord
    then loses its direction, and the caught cable can appear to be in equilibrium. Kinks of sound
    states are below 0.01 on meshes of 9 cells a side."""
    light_turn: float = 0.04
    """Turn of a cable at a contact beside a crossing up to which this may be open instead. With
    0.05, one of 500 random scenes ends with 0.4 % more energy."""
    tense_kink: float = 0.01
    """Kink above which fold points of a cable with friction are straightened."""
    round_gain: float = 1e-5
    """Gain of energy, relative to the sum of all kinds, that a round of passing vertices must bring
    for another one. Meshes of 64 cells a side have a hundred times that error. On a roof of 30 000
    unknowns under 28 cables the rounds below this take a quarter of a load step, for 3e-5 of its
    energy."""

    path_residual: float = 1e-3
    """Residual, relative to the force scale, below which paths are examined. Contacts are updated
    earlier: a wrong contact can be undone, a passed vertex cannot."""
    contact_residual: float = 0.1
    """Residual, relative to the weakest tension, below which contacts are updated: with a larger
    one taut cables would be taken for slack."""
    wrinkled: float = 0.5
    """Share of the area that is wrinkled or slack above which other states are looked for: one or
    two solves more."""
    near_state: float = 0.1
    """Largest distance of another state, relative to the membrane's size: folds move by less, and
    what has not snapped through must not do so in the search."""

    @property
    def pressed(self) -> float:
        """Distance from a vertex, as a fraction of the edge, within which a frictionless point is
        held as if on it; beyond, lengths are not smoothed."""
        return 2 * self.smoothing

    @property
    def gripped(self) -> float:
        """The same of a point with friction, including one put on the edge at `inside`."""
        return 1.25 * self.inside


TOL = Discretisation()
"""The values used everywhere; only benchmarks try others."""


@dataclass(frozen=True)
class Budget:
    """Limits of the loops of a load step: beyond most of them it ends with an error."""

    follower_solves: int = 50
    """Solves per increment under wind, or under lagged pressure with free edges."""
    passes: int = 40
    """Updates of the friction forces."""
    patience: int = 20
    """Updates without a smaller change before giving up: where the state responds strongly to a
    small change of force, as at the edge of lifting off, the iteration cycles."""
    lengths: int = 30
    """Repeated solves for the length that smoothing adds to cables."""
    changes: int = 60
    """Path changes, and projections of lifted parts' paths below their spans."""
    switches: int = 6
    """Switches between slack and taut of each cable in one solve on given paths."""
    halvings: int = 2
    """Times that a rejected set of runs that pass vertices is halved."""
    there_and_back: int = 3
    """Passes to either side of a vertex: the friction bounds on each side may favour the other."""
    misled: int = 2
    """Geodesics of higher energy after which only the forces at vertices propose paths."""
    misled_at_crossings: int = 1
    """The same for crossed cables, for which geodesics are less reliable."""
    crossings: int = 4
    """Crossings up to which alternatives are tried. Nets have some at each crossing, each with a
    change of energy far below the mesh error; taking some of them makes tensions jump between
    loads."""
    crossing_trials: int = 12
    """Alternatives that are tried."""
    boundary_edges: int = 1000
    """Boundary edges that an end may pass."""
    cells_below: int = 10_000
    """Cells under a span."""


BUDGET = Budget()
"""The limits used everywhere; only tests set others."""
