"""All sweeps by name."""

from __future__ import annotations

from sweeps import fabrics, loads, ropes, smoothing
from sweeps.judge import Sweep

SWEEPS: dict[str, Sweep] = {
    "stiffness": ropes.stiffness,
    "pressure": loads.pressure,
    "prestress": loads.prestress,
    "penalty": smoothing.penalty,
    "smoothing": smoothing.smoothing,
    "friction-sideways": ropes.friction_sideways,
    "friction-along": ropes.friction_along,
    "orthotropy": fabrics.orthotropy,
    "slivers": fabrics.slivers,
    "jumps": fabrics.jumps,
    "places": ropes.places_on_mesh,
    "short": ropes.short,
    "cycles": ropes.cycles,
    "floor": loads.deflation,
    "snow": loads.snow,
    "ends": ropes.ends,
    "units": smoothing.units,
}
