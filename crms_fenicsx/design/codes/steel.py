"""Steel bars by EN 1993-1-1: stiffness, strength and buckling curve of a section."""

from __future__ import annotations

import re
from typing import Literal

import numpy as np

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Positive, checked
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.bar import Bar
from crms_fenicsx.model.temperature import STEEL

SECTION = re.compile(r"(CHS|SHS|RHS) (\d+\.?\d*(?:x\d+\.?\d*)+)")
SIZES = {"CHS": 2, "SHS": 2, "RHS": 3}
"""Number of sizes in the names of hollow sections."""


@checked
def steel_bar(
    section: str | tuple[float, float],
    f_y: Positive,
    *,
    curve: Literal["a0", "a", "b", "c", "d"] | None = None,
    E: Positive = 210e6,
    gamma_M: Positive = 1.0,
    buckling_length: Positive | None = None,
    tension_only: bool = False,
) -> Bar:
    """Make a bar of a steel section, judged by EN 1993-1-1, 6.2.3 (tension), 6.2.4 and 6.3.1
    (compression with buckling). Units m and kN where the section is named.

    Parameters
    ----------
    section
        Hollow section by its sizes in mm, "CHS 168.3x8", "SHS 100x5" or "RHS 100x50x5" (hot
        finished, corners of EN 10210-2), or area A and second moment of area I about the weak axis
        (length^2, length^4).
    f_y
        Yield strength (force / length^2), 235e3 kN/m^2 of S235 up to 16 mm.
    curve
        Buckling curve, table 6.2: "a" of hot-finished hollow sections up to S420, "c" of
        cold-formed ones. None: a compressed bar is not judged.
    E
        Young's modulus (force / length^2).
    gamma_M
        Partial factor gamma_M0 = gamma_M1, 1.0 as recommended in 6.1.
    buckling_length
        Buckling length (length); None: the distance of the bar's ends, which are hinges.
    tension_only
        As for `Bar`.

    Returns
    -------
    Bar
        With EA, EI, strength A f_y / gamma_M, curve, gamma_M, the expansion of 3.2.6, and these
        data as its `section`. The plastic resistance assumes sections of the classes 1 to 3; holes
        and threads are not deducted.

    Raises
    ------
    InputError
        An unknown section, sizes that make none, or f_y and E of different units.

    Examples
    --------
    >>> mast = codes.steel_bar("CHS 168.3x8", 235e3, curve="a")
    >>> round(mast.strength), round(mast.EI), round(mast.reduction(5.5) * mast.strength)
    (947, 2724, 609)
    """
    told = ""
    if isinstance(section, str):
        area, inertia = _hollow(section)
        told = f"{section}: A = {1e4 * area:.4g} cm², I = {1e8 * inertia:.4g} cm⁴, f_y = "
        told += f"{f_y / 1e3:.4g} N/mm²"
    else:
        area, inertia = checks.pair("steel_bar: section", section)
        for name, value in (("A", area), ("I", inertia)):
            checks.positive(f"steel_bar: {name} of the section", value)
        told = f"A = {area:.4g}, I = {inertia:.4g}, f_y = {f_y:.4g}"
    if not 100.0 <= E / f_y <= 3000.0:
        raise InputError(
            f"steel_bar: f_y = {f_y:g} and E = {E:g} are not those of steel; pass both in the same "
            "units: S235 has 235e3 kN/m^2, with E = 210e6 kN/m^2."
        )
    return Bar(
        EA=E * area, EI=E * inertia, strength=area * f_y / gamma_M, curve=curve, gamma_M=gamma_M,
        buckling_length=buckling_length, tension_only=tension_only, section=told, expansion=STEEL,
    )  # fmt: skip


def _hollow(name: str) -> tuple[float, float]:
    """Area (m^2) and least second moment of area (m^4) of a named hollow section; EN 10210-2,
    annex B, with outer and inner corner radii of 1.5 and 1 thicknesses."""
    found = SECTION.fullmatch(name)
    kind, sizes = found.groups() if found else ("", "")
    numbers = [float(one) / 1000 for one in sizes.split("x") if one]
    *outer, t = numbers or [0.0]
    if len(numbers) != SIZES.get(kind) or not 0.0 < 2 * t <= min(outer):
        raise InputError(
            f'steel_bar: section = {name!r} is not a hollow section; write "CHS 168.3x8", "SHS '
            '100x5" or "RHS 100x50x5", or pass A and I.'
        )
    if kind == "CHS":
        r, inner = outer[0] / 2, outer[0] / 2 - t
        return np.pi * (r**2 - inner**2), np.pi * (r**4 - inner**4) / 4
    b, h = max(outer), min(outer)  # bent about the weak axis
    area = 2 * t * (b + h - 2 * t)
    inertia = (b * h**3 - (b - 2 * t) * (h - 2 * t) ** 3) / 12
    for radius, side, sign in ((1.5 * t, h, -1), (t, h - 2 * t, 1)):
        corner = (1 - np.pi / 4) * radius**2
        away = side / 2 - (10 - 3 * np.pi) / (12 - 3 * np.pi) * radius
        own = (1 / 3 - np.pi / 16 - 1 / (3 * (12 - 3 * np.pi))) * radius**4
        area, inertia = area + sign * 4 * corner, inertia + sign * 4 * (own + corner * away**2)
    return area, inertia
