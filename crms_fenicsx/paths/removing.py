"""Taking a cable away: what the others had to do with it goes with it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from crms_fenicsx.cables.crossings import arrange
from crms_fenicsx.cables.strip_gather import cells_at
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.scene import Cables

if TYPE_CHECKING:
    from crms_fenicsx.scene import Scene


def remove(scene: Scene, cable: LaidCable | str) -> None:
    """Take a cable of a scene away; see `Scene.remove`. Collective."""
    gone = scene.cable(cable) if isinstance(cable, str) else cable
    if not isinstance(gone, LaidCable) or gone not in scene.cables:
        raise InputError(
            f"remove: {gone!r} is not a cable of this scene; give one of scene.cables, or its name."
        )
    number = scene.cables.index(gone)

    def renumbered(c: int) -> int:
        return -1 if c == number else c - (c > number)  # -1: of a cable that is gone

    crossings = tuple(  # the nodes refer to them by number until they are arranged anew
        replace(crossing, lower=renumbered(crossing.lower), upper=renumbered(crossing.upper))
        for crossing in scene.crossings
    )
    scene._dissipated += gone.dissipated
    scene._cables = Cables.of(scene, (own for own in scene.cables if own is not gone))
    points = (node.point for own in scene.cables for node in own.nodes)
    vertices = [vertex for point in points if point is not None for vertex in point.support]
    scene.strip = cells_at(scene, vertices) if vertices else None
    scene.crossings = () if scene.strip is None else arrange(scene.cables, scene.strip, crossings)
