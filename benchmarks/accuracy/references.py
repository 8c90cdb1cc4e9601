"""Continuum solutions of the benchmark's cases, with error bars and sources.

Units: kgf and cm; the dome net m and kN.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Reference:
    """A value in the continuum.

    Attributes
    ----------
    value, bar
        The value, and how far it may be from the truth: errors below the bar mean nothing.
    source
        Where it is from.
    """

    value: float
    bar: float
    source: str


ODE = "shooting, an ordinary differential equation in the radius"
INDEPENDENT = "independent programs on structured meshes, extrapolated"
CONFORMING = "a mesh that follows the cable's unknown material curve, extrapolated"
LINES = "our meshes with lines under the cable, N = 64 and 128, extrapolated with order 2"
COMPRESSIBLE = "our meshes without wrinkling, N = 32 and 64, extrapolated with order 2"
FREE = "our free meshes, n = 16, 24, 40 and 50, extrapolated with order 2"
FINEST = "our free meshes, n = 28 and 40: nearer they scatter"
OWN_NET = "our two finest meshes, n = 40 and 56, extrapolated with orders 2 and 3"

REFERENCES: dict[str, dict[str, Reference]] = {
    "circle": {
        "W": Reference(-2908.73474049, 1e-6, ODE),
        "V": Reference(392408.510, 1e-2, ODE),
    },
    "square": {
        "W": Reference(-375.64923, 2e-5, INDEPENDENT),
        "w": Reference(10.184544, 3e-6, INDEPENDENT),
    },
    "square, compressible": {
        "W": Reference(-375.6227, 1e-2, COMPRESSIBLE),
        "w": Reference(10.18588, 3e-4, COMPRESSIBLE),
    },
    "centre cable": {
        "W": Reference(-273.55493, 1e-4, INDEPENDENT),
        "T": Reference(112.60349, 2e-4, INDEPENDENT),
    },
    "centre cable, compressible": {
        "W": Reference(-273.5346, 5e-3, COMPRESSIBLE),
        "T": Reference(112.5885, 3e-3, COMPRESSIBLE),
    },
    "sliding cable": {
        "W": Reference(-298.76483, 1e-4, CONFORMING),
        "T": Reference(103.0532, 2e-4, CONFORMING),
    },
    "model 2": {
        "z": Reference(1.95239, 5e-5, LINES),
        "T": Reference(252.9913, 2e-4, LINES),
    },
    "model 2, compressible": {
        "z": Reference(1.95388, 3e-4, COMPRESSIBLE),
        "T": Reference(252.9838, 3e-3, COMPRESSIBLE),
    },
    "model 3, smooth": {
        "W": Reference(427.65, 0.1, FREE),
        "T": Reference(385.62, 0.02, FINEST),
    },
    "model 3, rough": {
        "y": Reference(5.950, 0.01, FINEST),
        "T": Reference(493.15, 0.1, FINEST),
    },
    "dome net": {
        "W": Reference(-25.80, 0.03, OWN_NET),
        "T": Reference(12.215, 0.01, OWN_NET),
    },
}


def reference(name: str, quantity: str, compressible: bool = False) -> Reference:
    """The reference of a case's quantity.

    Parameters
    ----------
    name
        Of the case's references.
    quantity
        For example "W".
    compressible
        Whether the membrane resists compression, which is another problem where it is compressed.
    """
    own = f"{name}, compressible"
    return REFERENCES[own if compressible and own in REFERENCES else name][quantity]
