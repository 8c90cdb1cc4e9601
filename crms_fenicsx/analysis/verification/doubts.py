"""What a doubtful state leaves uncertain: ranges of tensions, in words.

Where the mesh holds a cable sideways that is free to slide, it keeps the cable longer than the
string that is taut over the same edges, drawn straight between their vertices, and than the cable
that the vertices let go. An end inside a cell lies below the smooth surface, and if it was given in
plan, farther down its slope. The tension lies between those of the lengths. See
docs/theory/verification.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.optimize import minimize

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.verification.report import Check
from crms_fenicsx.cabling.cables.strip import NOBODY, StripShape
from crms_fenicsx.cabling.contact.contact_force import contact_forces
from crms_fenicsx.cabling.paths.held_vertices import held_vertices, string_displacements
from crms_fenicsx.foundation.meshes.smooth_surface import SmoothSurface
from crms_fenicsx.foundation.meshes.triangles import arc_lengths, norm
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.versions import StateWarning

HELD_SIDEWAYS = {
    "held by a line of the mesh", "held by vertices", "sideways force without friction",
    "friction beyond its bound",
}  # fmt: skip
"""Checks of what the mesh holds sideways."""

SHOWN = 3
"""Number of cables told of in one warning."""

STEEP = 0.1
"""Least vertical part of a normal where ends may have been given in plan."""

LARGE = 0.1
"""Share of the excess of length from which its reason is told."""

EXACT = {"ftol": 1e-12, "gtol": 1e-9}
"""Tolerances of a string's length and of its slopes, relative to its length."""

Doubts = Mapping[LaidCable, Sequence[Check]]
"""Failed checks of each cable that make a state doubtful."""


def doubt(scene: Scene, failed: Sequence[Check], cables: Doubts) -> StateWarning:
    """Warning of a state that fails some checks, which are not binding. Collective."""
    told = list[str]()
    if cables:
        shape = scene.net.strip_shape()
        for cable, own in cables.items():
            told += _of_cable(cable, own, shape)
    more = [f"and {len(told) - SHOWN} more for cables"] if len(told) > SHOWN else []
    told = told[:SHOWN] + more
    told += [words for check in failed for words in _of_scene(check)]
    return StateWarning("doubtful", scene.comm.bcast("; ".join(told)))


def _of_cable(cable: LaidCable, failed: Sequence[Check], shape: StripShape) -> Iterator[str]:
    """What is uncertain about a cable."""
    by_name = {check.name: check.value for check in failed}
    T = cable.tension
    if HELD_SIDEWAYS & by_name.keys():
        low, _ = tension_range(cable, shape)
        at_ends = _longer_at_ends(cable, shape)
        large = at_ends > LARGE * _longer(cable, shape)
        ends = ", and its ends inside cells, if given in plan, lie too far down the slope"
        yield (
            f"the tension of {cable.name!r} is between {low:.3g} and {T:.3g}: the mesh holds it "
            f"sideways{'' if cable.slides_freely else ' beyond its friction'} and keeps it too "
            f"long{ends if large else ''}; smaller cells along it narrow this range"
        )
    if "pull on the membrane" in by_name:
        force = by_name["pull on the membrane"] * T
        yield (
            f"{cable.name!r} pulls the membrane outward by up to {force:.3g} at a point where it "
            "should be off it; another load step lets it lift off"
        )
    if "depth below the membrane" in by_name:
        depth = by_name["depth below the membrane"]
        yield (
            f"{cable.name!r} runs up to {depth:.2g} of a cell under the membrane between its "
            "contacts"
        )
    if "depth below another cable" in by_name:
        depth = by_name["depth below another cable"]
        yield (
            f"{cable.name!r} runs up to {depth:.2g} of a cell under a cable that it lies over; "
            "another load step lets them touch"
        )
    if "depth in a cable beside" in by_name:
        yield (
            f"{cable.name!r} is nearer to a cable beside it than both radii, by "
            f"{by_name['depth in a cable beside']:.1%}: their contact is as soft as the fabric"
        )
    if "held where its line stays" in by_name:
        yield (
            f"{cable.name!r} is held sideways by {by_name['held where its line stays']:.0%} of its "
            "contact force where its line stays: at bars, loads on vertices, ends of other cables, "
            "creases or borders of parts, or where it would not come to rest in the load step"
        )
    if "sideways balance" in by_name:
        share = by_name["sideways balance"]
        yield (
            f"{cable.name!r} may lie elsewhere across its line: its sideways forces balance to "
            f"{share:.1%} of its contact forces only"
        )
    if "unbalanced forces of cables" in by_name:
        share = by_name["unbalanced forces of cables"]
        yield (
            f"the tension of {cable.name!r}, {T:.3g}, is {_known(share)}: its forces balance no "
            "better, as they are small beside the scene's largest, which set the tolerance"
        )


def _of_scene(check: Check) -> Iterator[str]:
    """What is uncertain about the membrane or a bar."""
    if check.name == "unbalanced forces of the membrane":
        yield (
            f"forces of the membrane are {_known(check.value)}: they balance no better, as "
            "they are small beside the scene's largest, which set the tolerance"
        )
    if check.name == "scatter of the energy":
        yield (
            f"there are {check.where}, with energies {check.value:.2g} apart; the lowest is kept"
        )
    if check.name == "unbalanced forces of bars":
        yield (
            f"forces of bars at {check.where!r} are {_known(check.value)}: they balance no better"
        )


def _known(share: float) -> str:
    """How well forces are known that balance to a share of their own size."""
    return f"accurate to {share:.1%} only" if share < 1.0 else "uncertain by 100% or more"


def tension_range(cable: LaidCable, shape: StripShape) -> tuple[float, float]:
    """Least and largest tension of a cable that the mesh holds sideways (force)."""
    start = cable.state.law.step_start
    rate = cable.cable.EA / (cable.L0 if start is None else start.length)
    return max(cable.tension - rate * _longer(cable, shape), 0.0), cable.tension


def _longer(cable: LaidCable, shape: StripShape) -> float:
    """Excess of a cable's length on coarse cells (length)."""
    sideways = _longer_by_edges(cable, shape) + _longer_by_vertices(cable, shape)
    return sideways + _longer_at_ends(cable, shape)


def _longer_at_ends(cable: LaidCable, shape: StripShape) -> float:
    """Length by which ends given in plan lie farther down the slope, and so apart, in cells that
    are below the smooth surface (length)."""
    ends = [k for k in (0, -1) if cable.state.nodes[k].kind == "tied"]
    if not ends:
        return 0.0
    strip = shape.strip
    solid = strip.cells[strip.is_outer & (strip.owner != NOBODY)]
    surface = SmoothSurface.of(shape.current, np.searchsorted(strip.vertices, solid))
    found = [cable.state.nodes[k].interpolation() for k in ends]
    corners = np.array([(*(strip.row_of[v] for v in ids), 0, 0)[:3] for ids, _ in found])
    weights = np.array([(*share, 0.0, 0.0)[:3] for _, share in found])
    offsets, normals = surface.raised(corners, weights)
    ways = np.diff(cable.state.positions, axis=0)[ends]
    upright = np.maximum(np.abs(normals[:, 2]), STEEP)
    # The point above is offset / upright higher, of which the part along the cable counts.
    return float(np.sum(norm(offsets) / upright * np.abs(ways[:, 2]) / norm(ways)))


def _longer_by_edges(cable: LaidCable, shape: StripShape) -> float:
    """Excess of a cable's length over that of the string over the same edges, drawn straight, less
    what friction carries."""
    contacts = np.array(cable.contacts())
    places = cable.state.positions[contacts]
    blocked = cable.blocked
    free = [
        i
        for i, k in enumerate(contacts)
        if cable.state.nodes[k].kind == "fold" and k not in blocked
    ]
    if not free:
        return 0.0
    edges = np.array([cable.state.nodes[k].support for k in contacts[free]])
    ends = shape.current[np.searchsorted(shape.strip.vertices, edges)]
    now = float(arc_lengths(places)[-1])
    ways, string = ends[:, 1] - ends[:, 0], places.copy()

    def length(fractions: Array) -> tuple[float, Array]:
        string[free] = ends[:, 0] + fractions[:, None] * ways
        steps = np.diff(string, axis=0)
        sizes = norm(steps)
        units = steps / np.maximum(sizes, EPSILON * sizes.sum())[:, None]
        slopes = np.concatenate([units[:1], units, units[-1:]])
        slopes = (slopes[:-1] - slopes[1:])[free]
        return float(sizes.sum()) / now, np.sum(slopes * ways, axis=1) / now

    first = np.clip(cable.state.fractions[contacts[free]], 0.0, 1.0)
    bounds = [(0.0, 1.0)] * len(free)
    found = minimize(length, first, jac=True, method="L-BFGS-B", bounds=bounds, options=EXACT)
    excess = now * max(1.0 - float(found.fun), 0.0)
    return excess * _share_beyond_friction(cable, shape, [int(k) for k in contacts[free]])


def _share_beyond_friction(cable: LaidCable, shape: StripShape, nodes: list[int]) -> float:
    """Share of the length that lateral forces at nodes add to a string which goes without those
    beyond the friction's bounds."""
    if not cable.has_coulomb or cable.cable.sideways is None:
        return 1.0
    forces = contact_forces(cable, shape).at(nodes)
    bounds = cable.cable.sideways.at_rest * forces.bearing
    contacts = cable.contacts()
    arc = arc_lengths(cable.state.positions[contacts])
    places = np.concatenate([arc[:1], arc[np.searchsorted(contacts, nodes)], arc[-1:]])
    now, then = (
        float(pulls @ string_displacements(places, pulls))
        for pulls in (forces.lateral, np.clip(forces.lateral, -bounds, bounds))
    )
    return min(max(1.0 - then / now, 0.0), 1.0) if now > 0.0 else 1.0


def _longer_by_vertices(cable: LaidCable, shape: StripShape) -> float:
    """Length that the pulls of vertices add to a cable: that of a string under them."""
    held = held_vertices(cable, shape)
    if not held:
        return 0.0
    contacts = cable.contacts()
    arc = arc_lengths(cable.state.positions[contacts])
    at = arc[np.searchsorted(contacts, [one.nodes[0] for one in held])]
    turns = np.array([one.pull for one in held]) / cable.tension
    moved = string_displacements(np.concatenate([arc[:1], at, arc[-1:]]), turns)
    return float(np.abs(turns @ moved)) / 2
