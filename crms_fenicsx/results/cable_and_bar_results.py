"""Forces of cables and bars."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.contact.contact_force import contact_forces
from crms_fenicsx.meshes.triangles import norm
from crms_fenicsx.model.laid_cable import CableEnd, LaidCable
from crms_fenicsx.runtime.arrays import Array, floats
from crms_fenicsx.runtime.checks import span
from crms_fenicsx.scene import Scene

Force = tuple[float, float, float]


def triple(force: Array) -> Force:
    """The three numbers of a vector."""
    x, y, z = floats(force)
    return x, y, z


@dataclass(frozen=True, repr=False)
class CableResults:
    """A cable in an equilibrium, by plain numbers.

    Attributes
    ----------
    name
        Of the cable.
    least, mean, largest
        Tension (force) along the cable; they differ where friction along it holds it. The mean is
        by unstressed length.
    slack
        Whether it has no tension.
    length, L0, free
        Current and unstressed length, and the current length off the membrane (length).
    contact_mean, contact_largest
        Normal force on the membrane per length of cable (force per length): its mean over the
        length on the membrane, and its largest value; zero where it touches nothing.
    start, end
        Forces with which the anchors hold its ends (force); None of an end that is tied to the
        membrane or fixed to a joint.
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

    def __repr__(self) -> str:
        """In a line."""
        tension = "slack" if self.slack else f"tension {span([self.least, self.largest])}"
        return (
            f"CableResults({self.name!r}, {tension}, length {self.length:.6g}, "
            f"contact up to {self.contact_largest:.4g} per length)"
        )


def cable_results(scene: Scene) -> dict[str, CableResults]:
    """Forces of a scene's cables by their names, the same on all ranks. Collective."""
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
        )
    return found


def _contact(line: Array, sizes: Array) -> tuple[float, float]:
    """Mean and largest force per length, of values at the points of a cable's line."""
    on = np.isfinite(line)
    if not on.any():
        return 0.0, 0.0
    both = on[1:] & on[:-1]
    length = float(sizes[both].sum())
    means = (line[1:] + line[:-1])[both] / 2
    mean = float((means * sizes[both]).sum() / length) if length > 0.0 else 0.0
    return mean, float(line[on].max())


def _reaction(cable: LaidCable, end: CableEnd) -> Force | None:
    """Force of the anchor of an end; None if it has none."""
    k = cable.node_of(end.which)
    if cable.nodes[k].kind != "anchor" or cable.joints[min(k, 1)] is not None:
        return None
    return triple(end.reaction)


@dataclass(frozen=True)
class BarResults:
    """A bar in an equilibrium, by plain numbers."""

    name: str  # of the bar
    force: float  # axial force (force): tension is positive, compression negative
    slack: bool  # whether it is a guy without tension
    length: float  # length, L0: current and unstressed length (length)
    L0: float
    buckling: float | None = None  # Euler's load (force), and the share of the strength that is
    utilisation: float | None = None  # used; None where they are not known


def bar_results(scene: Scene) -> dict[str, BarResults]:
    """Forces of a scene's bars in its current state, by their names."""
    return {
        bar.name: BarResults(
            bar.name, bar.force, bar.slack, bar.length, bar.L0, bar.buckling, bar.utilisation
        )
        for bar in scene.bars
    }


def joint_reactions(scene: Scene) -> dict[str, Force]:
    """Forces with which held joints are held (force), by their names."""
    return {joint.name: triple(joint.reaction) for joint in scene.joints if joint.held.any()}
