"""Forces of cables, bars and clamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.contact.contact_force import contact_forces
from crms_fenicsx.foundation.meshes.triangles import cross, norm
from crms_fenicsx.foundation.runtime.arrays import Array, floats
from crms_fenicsx.foundation.runtime.checks import span
from crms_fenicsx.model.bar import PlacedBar
from crms_fenicsx.model.cable import Clamp
from crms_fenicsx.model.laid_cable import CableEnd, LaidCable
from crms_fenicsx.model.strengths import SERVICE

Force = tuple[float, float, float]


def triple(force: Array) -> Force:
    """The three numbers of a vector."""
    x, y, z = floats(force)
    return x, y, z


@dataclass(frozen=True, repr=False)
class CableResults:
    """Results of a cable in equilibrium.

    Attributes
    ----------
    name
        Name of the cable.
    least, mean, largest
        Tension (force) along the cable, varying where there is friction along it; the mean is
        weighted by unstressed length.
    slack
        Whether the cable is slack.
    length, L0, free
        Current length, unstressed length, and current length off the membrane (length).
    contact_mean, contact_largest
        Normal force on the membrane per length of cable (force per length): mean over the length in
        contact, and largest value; zero without contact.
    start, end
        Forces of the anchors on the ends (force); None at an end tied to the membrane or fixed to a
        joint.
    strength
        Design value of the tension in this limit state (force), see `Scene.set_strengths`; None if
        unknown.
    """

    name: str
    least: float
    mean: float
    largest: float
    slack: bool
    length: float
    L0: float
    free: float
    contact_mean: float
    contact_largest: float
    start: Force | None
    end: Force | None
    strength: float | None = None

    @property
    def utilisation(self) -> float | None:
        """Largest tension over the strength; None if that is unknown."""
        return None if self.strength is None else self.largest / self.strength

    def __repr__(self) -> str:
        """One line."""
        tension = "slack" if self.slack else f"tension {span([self.least, self.largest])}"
        return (
            f"CableResults({self.name!r}, {tension}, length {self.length:.6g}, "
            f"contact up to {self.contact_largest:.4g} per length)"
        )


def cable_results(scene: Scene) -> dict[str, CableResults]:
    """Results of a scene's cables by name, the same on all ranks. Collective."""
    if not scene.cables:
        return {}
    shape = scene.net.strip_shape()
    found = {}
    for cable in scene.cables:
        line = contact_forces(cable, shape).line[cable.line_nodes()]
        sizes = norm(np.diff(cable.line, axis=0))
        mean, largest = _contact(line, sizes)
        found[cable.name] = CableResults(
            cable.name,
            float(cable.tensions.min()),
            cable.tension,
            float(cable.tensions.max()),
            not cable.taut,
            cable.length,
            cable.L0,
            float(sizes[cable.free_spans].sum()),
            mean,
            largest,
            _reaction(cable, cable.start),
            _reaction(cable, cable.end),
            scene.design.of_cable(cable.name, scene.case.state),
        )
    return found


def _contact(line: Array, sizes: Array) -> tuple[float, float]:
    """Mean and largest force per length, from values at the points of a cable's line."""
    on = np.isfinite(line)
    if not on.any():
        return 0.0, 0.0
    both = on[1:] & on[:-1]
    length = float(sizes[both].sum())
    means = (line[1:] + line[:-1])[both] / 2
    mean = float((means * sizes[both]).sum() / length) if length > 0.0 else 0.0
    return mean, float(line[on].max())


def _reaction(cable: LaidCable, end: CableEnd) -> Force | None:
    """Anchor force at an end; None without an anchor."""
    k = cable.node_of(end.which)
    if cable.state.nodes[k].kind != "anchor" or cable.state.laid.joints[min(k, 1)] is not None:
        return None
    return triple(end.reaction)


@dataclass(frozen=True)
class BarResults:
    """Results of a bar in equilibrium.

    Attributes
    ----------
    name
        Name of the bar.
    force
        Axial force (force), tension positive.
    slack
        Whether the bar is a slack guy.
    length, L0
        Current and unstressed length (length).
    buckling
        Euler load (force); None if unknown.
    utilisation
        Utilisation of the strength; None if unknown, or in a serviceability limit state. Of a guy
        that `Scene.set_strengths` names, as of a cable.
    """

    name: str
    force: float
    slack: bool
    length: float
    L0: float
    buckling: float | None = None
    utilisation: float | None = None


def bar_results(scene: Scene) -> dict[str, BarResults]:
    """Results of a scene's bars by name."""
    return {
        bar.name: BarResults(
            bar.name,
            bar.force,
            bar.slack,
            bar.length,
            bar.L0,
            bar.buckling,
            _utilisation(scene, bar),
        )
        for bar in scene.bars
    }


def _utilisation(scene: Scene, bar: PlacedBar) -> float | None:
    """Utilisation of a bar in the present limit state: of ropes that are guys as of cables."""
    if scene.design.is_rope(bar):
        limit = scene.design.of_cable(bar.name, scene.case.state)
        return None if limit is None else bar.force / limit
    return None if scene.case.state in SERVICE else bar.utilisation


def joint_reactions(scene: Scene) -> dict[str, Force]:
    """Reactions of held joints by name (force)."""
    return {joint.name: triple(joint.reaction) for joint in scene.joints if joint.held.any()}


Pair = tuple[float, float]


@dataclass(frozen=True)
class ClampResults:
    """Results of a clamp in equilibrium.

    Attributes
    ----------
    name
        Name of the clamp.
    place
        Position, (3,) (length).
    before, after
        Tensions of the two cables before and after the clamp, along their directions (force).
    force
        Tangential force that the clamp transfers from the first cable to the second, (3,) (force).
    """

    name: str
    place: Force
    before: Pair
    after: Pair
    force: Force

    @property
    def differences(self) -> Pair:
        """Increase of its cables' tensions at the clamp (force)."""
        return self.after[0] - self.before[0], self.after[1] - self.before[1]

    @property
    def size(self) -> float:
        """Magnitude of the tangential force on the clamp (force)."""
        return float(np.linalg.norm(self.force))


def clamp_results(scene: Scene) -> dict[str, ClampResults]:
    """Results of a scene's clamps by name; zero if a cable is slack."""
    return {clamp.name: _results(scene, clamp) for clamp in scene.clamps}


def _results(scene: Scene, clamp: Clamp) -> ClampResults:
    sides = [_side(scene.cable(name), at) for name, at in zip(clamp.cables, clamp.at, strict=True)]
    (first, ways), (second, others) = sides
    # Each cable pulls with T2 t2 - T1 t1; air and membrane carry the part normal to both.
    pulls = [side[1] * way[1] - side[0] * way[0] for side, way in sides]
    across = cross(ways.sum(axis=0), others.sum(axis=0))
    normal = across / max(float(norm(across)), 1e-300)
    force = (pulls[0] - pulls[1]) / 2
    force = force - (force @ normal) * normal
    before, after = (first[0], second[0]), (first[1], second[1])
    return ClampResults(clamp.name, triple(clamp.place), before, after, triple(force))


def _side(cable: LaidCable, at: float) -> tuple[Pair, Array]:
    """Tensions before and after a clamp, and the cable's directions there, (2, 3)."""
    if cable.state.law.parts is None or not cable.state.law.parts.nodes:
        return (0.0, 0.0), np.zeros((2, 3))
    i = int(np.argmin(np.abs(cable.state.law.parts.at - at)))
    contacts = cable.contacts()
    k = contacts.index(cable.state.law.parts.nodes[i])
    ways = np.diff(cable.state.positions[contacts[k - 1 : k + 2]], axis=0)
    before, after = floats(cable.part_tensions[k - 1 : k + 1])
    return (before, after), np.asarray(ways / np.maximum(norm(ways), 1e-300)[:, None])
