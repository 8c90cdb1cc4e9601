"""Random scenes of many features at once, as plain data. Lengths are m, forces kN."""

from __future__ import annotations

from typing import Any

import numpy as np
from walled_roof import walled_roof

from crms_fenicsx.foundation.runtime.arrays import Array
from fuzzing.scenes import WIDTH, Draws, Event, SceneData, Seeded, mesh, of

SIZE = 10.0
"""Width of the membranes."""
FEATURE_TWINS = (
    "turned", "mm-N", "tiny", "huge", "order", "resume", "branch", "load", "outputs", "verify",
    "stopped",
)  # fmt: skip
"""Scenes, or scripts, that must have the same answer."""


def happens(draws: Draws, chance: float) -> bool:
    """Whether something happens."""
    return draws.real(0.0, 1.0) < chance


def vector(draws: Draws, size: float) -> tuple[float, float, float]:
    """A random vector."""
    return (draws.real(-size, size), draws.real(-size, size), draws.real(-size, size))


def feature_scene(number: int) -> SceneData:
    """The scene with a number."""
    draws = Seeded(number + 10**6)
    source = of(draws, ("arrays", "arrays", "dolfinx", "form", "walled"))
    kinds = ("structured", "jiggled", "square", "hole", "polygon", "cap", "cap")
    kind = "structured" if source == "form" else of(draws, kinds)
    walls = 0
    if source == "walled":
        points, cells, parts = walled_roof(
            of(draws, (4, 6)), SIZE, height=2.0, rise=of(draws, (0.0, 1.0)), levels=1
        )
        points, kind, walls = points - (SIZE / 2, SIZE / 2, 0.0), "walled", len(parts["wall"])
    else:
        points, cells = mesh(kind, draws.integer(4, 6), draws.integer(0, 10**6))
        points = points * (SIZE / WIDTH)
    laws: dict[str, str] = {}
    if source != "form" and happens(draws, 0.15):
        laws = of(draws, ({"strain": "step"}, {"pressure": "step"},
                          {"strain": "step", "pressure": "step"}))  # fmt: skip
    wrinkling = happens(draws, 0.6) and "strain" not in laws
    prestress = of(draws, (0.0, 1.0, 2.0)) if kind == "cap" else of(draws, (1.0, 2.0, 4.0))
    if source != "form" and happens(draws, 0.35):
        material: tuple[str, dict[str, Any]] = ("orthotropic", {
            "E1": 600.0, "E2": 400.0, "G12": 30.0, "nu21": 0.2, "thickness": 1.0,
            "warp": (1.0, 0.4, 0.0), "prestress": prestress, "wrinkling": wrinkling,
        })  # fmt: skip
    else:
        material = ("isotropic", {
            "E": of(draws, (200.0, 1000.0)), "nu": 0.3, "thickness": 1.0,
            "prestress": prestress, "wrinkling": wrinkling,
        })  # fmt: skip
    sides = kind in ("structured", "jiggled") and source != "form"
    held = "plane" if sides and happens(draws, 0.15) else "all"
    inflated = source != "form" and (kind == "cap" or happens(draws, 0.5))
    features = tuple(_features(draws, points, kind, source))
    events = tuple(_events(draws, dict(features), inflated, held))
    pressure = draws.real(0.1, 0.6) if inflated else None
    twins = np.random.default_rng(number).choice(FEATURE_TWINS, 2, replace=False)
    return SceneData(
        number, kind, points, cells, material, laws, held, pressure, features, events,
        tuple(twins.tolist()), source, walls, ambiguous=False,
    )  # fmt: skip


def _features(draws: Draws, points: Array, kind: str, source: str) -> list[Event]:
    """What is on a scene."""
    found: list[Event] = []
    if happens(draws, 0.5):
        found.append(("weight", {"force": 0.02, "per": of(draws, ("material", "surface"))}))
    if happens(draws, 0.5):
        found.append(("snow", {"force": draws.real(0.1, 0.5), "function": happens(draws, 0.5)}))
    if happens(draws, 0.5):
        kinds = ("number", "parts", "function")
        found.append(("wind", {"q": draws.real(0.1, 0.4), "kind": of(draws, kinds)}))
    if happens(draws, 0.2):
        found.append(("forces", {"F": vector(draws, 0.2)}))
    if happens(draws, 0.3):
        depth = draws.real(0.02, 0.2)
        found.append(("pond", {"by": of(draws, ("level", "volume")), "depth": depth,
                               "part": happens(draws, 0.2)}))  # fmt: skip
    if happens(draws, 0.35):
        found.append(("mast", {"x": draws.real(6.0, 9.0), "h": draws.real(2.0, 5.0),
                               "guys": draws.integer(2, 3), "F": vector(draws, 1.0)}))  # fmt: skip
    if happens(draws, 0.3):
        found.append(("prop", {"at": (draws.real(-2.0, 2.0), draws.real(-2.0, 2.0)),
                               "up": happens(draws, 0.5), "EA": of(draws, (1e2, 1e4)),
                               "guy": happens(draws, 0.4)}))  # fmt: skip
    if happens(draws, 0.25):
        found.append(("strengths", {"by part": happens(draws, 0.5)}))
    if happens(draws, 0.2):
        found.append(("floor", {"below": draws.real(1.0, 3.0)}))
    if happens(draws, 0.15):
        found.append(("term", {"k": draws.real(1.0, 20.0)}))
    has_mast = "mast" in dict(found)
    for k in range(of(draws, (0, 1, 1, 2, 2, 3))):
        found.append(("cable", _cable(draws, k, has_mast)))
    return found


def _cable(draws: Draws, k: int, has_mast: bool) -> dict[str, Any]:
    friction: dict[str, float] | None = None
    kind = of(draws, ("none", "none", "none", "sideways", "along", "both"))
    if kind != "none":
        friction = {"mu": 0.0 if kind == "along" else draws.real(0.05, 0.5)}
        if kind != "sideways":
            friction["along"] = draws.real(0.05, 0.3)
    angle = draws.real(0.0, np.pi)
    law = "step" if friction is None and happens(draws, 0.1) else "total"
    return {
        "law": law,
        "k": k, "angle": angle, "off": draws.real(-2.0, 2.0), "EA": of(draws, (500.0, 5000.0)),
        "friction": friction, "way": of(draws, ("across", "across", "anchors", "inside")),
        "joint": has_mast and happens(draws, 0.5), "sleeve": happens(draws, 0.15),
        "tension": None if law == "step" else of(draws, (None, None, 1.0, 5.0)),
    }  # fmt: skip


def _events(draws: Draws, has: dict[str, Any], inflated: bool, held: str) -> list[Event]:
    """What is done to a scene, beginning with its loads."""
    loads = [name for name in ("weight", "snow", "wind", "forces", "pond") if name in has]
    loads += ["lamp"] if "mast" in has else []
    events: list[Event] = [
        ("advance", {"load": {n: draws.real(0.3, 1.2) for n in loads if happens(draws, 0.8)},
                     "steps": of(draws, (1, 1, 2))})
    ]  # fmt: skip
    sealed = False
    for _ in range(draws.integer(1, 4)):
        kinds = ["loads", "move", "L0", "branch", "combine", "rest", "remove", "checkpoint"]
        kinds += ["turn", "function", "results"]
        if inflated:
            kinds += ["unseal", "air"] if sealed else ["seal", "pressure"]
        if inflated and not sealed and "wind" in has:
            kinds.append("fans")
        kind = of(draws, tuple(kinds))
        if kind == "seal":
            sealed = True
            events.append(("seal", {"volume": draws.real(100.0, 400.0),
                                    "exponent": of(draws, (1.0, 1.4))}))  # fmt: skip
        elif kind == "unseal":
            sealed = False
            events.append(("unseal", {}))
        elif kind == "air":
            events.append(("advance", {"temperature": draws.real(0.998, 1.003)}))
        elif kind == "pressure":
            events.append(("advance", {"pressure": draws.real(0.1, 0.8), "steps": 2}))
        elif kind == "fans":
            events.append(("advance", {"fans": (0.2, 0.6), "load": {"wind": draws.real(0.1, 1.0)},
                                       "steps": 2}))  # fmt: skip
        elif kind == "loads":
            if loads:
                name = of(draws, tuple(loads))
                events.append(("advance", {"load": {name: draws.real(0.0, 1.5)}}))
        elif kind in ("move", "turn", "function"):
            events.append(("advance", _motion(draws, kind, has)))
        elif kind == "L0":
            events.append(("advance", {"L0": draws.real(0.99, 1.01), "of": draws.integer(0, 5)}))
        elif kind == "remove":
            events.append(("remove", {"which": draws.integer(0, 9)}))
            events.append(("advance", {}))
        elif kind in ("branch", "combine"):
            chosen = {n: draws.real(0.2, 1.3) for n in loads if happens(draws, 0.6)}
            seal = inflated and not sealed and happens(draws, 0.5)
            events.append((kind, {"load": chosen, "seal": seal, "lay": happens(draws, 0.4),
                                  "remove": happens(draws, 0.3),
                                  "move": _motion(draws, "move", has)}))  # fmt: skip
        else:
            events.append((kind, {}))
    return events


def _motion(draws: Draws, kind: str, has: dict[str, Any]) -> dict[str, Any]:
    if kind == "turn":
        return {"turn": draws.real(-0.03, 0.03), "steps": 2}
    if kind == "function":
        return {"function": vector(draws, 0.04), "steps": of(draws, (1, 2))}
    what = of(draws, ("boundary", "west", "cable", "bar"))
    return {"move": what, "way": vector(draws, 0.08), "of": draws.integer(0, 5)}
