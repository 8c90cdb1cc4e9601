"""Pressure coefficients of curved roofs and canopies by EN 1991-1-4, for `Scene.put_wind`.

The zones are laid over any roof's current shape: fractions of its depth d along a direction and of
its breadth b across it.

No copy of the standard was available. The sources with which coefficients were compared are given
at each; compare those that a design relies on with your copy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.meshes.membrane_mesh import cells_of
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import (
    Finite,
    PlanDirection,
    Positive,
    checked,
    collective,
)
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array
from crms_fenicsx.foundation.runtime.errors import InputError

Zones = tuple[float, float, float]
"""Coefficients in the zones A (windward), B (crown) and C (leeward)."""

VAULT_RISES = (0.05, 0.5)
"""Range of f/d in figure 7.11."""

VAULT_ENDS = {"A": (0.1, 0.8), "B": (-0.8, -1.2), "C": (-0.4, -0.4)}
"""Ends of figure 7.11 for h/d = 0; straight lines replace its curves. A published reading at f/d =
0.26 (0.42, -0.96, -0.40) is met within 0.03."""

HEMISPHERE: Zones = (0.8, -1.2, 0.0)
"""Figure 7.12 for f/d = 0.5 and h/d = 0."""

Rows = dict[str, tuple[float, ...]]
"""Net coefficients by zones, for the pitches of a table."""

CANOPIES: dict[str, tuple[tuple[float, ...], Rows, Rows, Rows]] = {
    "monopitch": (
        (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0),
        {
            "overall": (0.2, 0.4, 0.5, 0.7, 0.8, 1.0, 1.2),
            "A": (0.5, 0.8, 1.2, 1.4, 1.7, 2.0, 2.2),
            "B": (1.8, 2.1, 2.4, 2.7, 2.9, 3.1, 3.2),
            "C": (1.1, 1.3, 1.6, 1.8, 2.1, 2.3, 2.4),
        },
        {
            "overall": (-0.5, -0.7, -0.9, -1.1, -1.3, -1.6, -1.8),
            "A": (-0.6, -1.1, -1.5, -1.8, -2.2, -2.6, -3.0),
            "B": (-1.3, -1.7, -2.0, -2.4, -2.8, -3.2, -3.8),
            "C": (-1.4, -1.8, -2.1, -2.5, -2.9, -3.2, -3.6),
        },
        {
            "overall": (-1.3, -1.4, -1.4, -1.4, -1.4, -1.4, -1.4),
            "A": (-1.5, -1.6, -2.1, -1.6, -1.6, -1.5, -1.5),
            "B": (-1.8, -2.2, -2.6, -2.9, -2.9, -2.5, -2.2),
            "C": (-2.2, -2.5, -2.7, -3.0, -3.0, -2.8, -2.7),
        },
    ),
    "duopitch": (
        (-20.0, -15.0, -10.0, -5.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0),
        {
            "overall": (0.7, 0.5, 0.4, 0.3, 0.3, 0.4, 0.4, 0.6, 0.7, 0.9),
            "A": (0.8, 0.6, 0.6, 0.5, 0.6, 0.7, 0.9, 1.1, 1.2, 1.3),
            "B": (1.6, 1.5, 1.4, 1.5, 1.8, 1.8, 1.9, 1.9, 1.9, 1.9),
            "C": (0.6, 0.7, 0.8, 0.8, 1.3, 1.4, 1.4, 1.5, 1.6, 1.6),
            "D": (1.7, 1.4, 1.1, 0.8, 0.4, 0.4, 0.4, 0.4, 0.5, 0.7),
        },
        {
            "overall": (-0.7, -0.6, -0.6, -0.5, -0.6, -0.7, -0.8, -0.9, -1.0, -1.0),
            "A": (-0.9, -0.8, -0.8, -0.7, -0.6, -0.7, -0.9, -1.2, -1.4, -1.4),
            "B": (-1.3, -1.3, -1.3, -1.3, -1.4, -1.5, -1.7, -1.8, -1.9, -1.9),
            "C": (-1.6, -1.6, -1.5, -1.6, -1.4, -1.4, -1.4, -1.4, -1.4, -1.4),
            "D": (-0.6, -0.6, -0.6, -0.6, -1.1, -1.4, -1.8, -2.0, -2.0, -2.0),
        },
        {
            "overall": (-1.3, -1.4, -1.4, -1.3, -1.3, -1.3, -1.3, -1.4, -1.3, -1.3),
            "A": (-1.5, -1.6, -1.6, -1.5, -1.3, -1.3, -1.3, -1.4, -1.4, -1.4),
            "B": (-2.4, -2.7, -2.7, -2.4, -2.0, -2.0, -2.2, -2.2, -2.0, -1.8),
            "C": (-2.4, -2.6, -2.6, -2.4, -1.8, -1.8, -1.6, -1.6, -1.5, -1.4),
            "D": (-0.6, -0.6, -0.6, -0.6, -1.5, -1.8, -2.1, -2.1, -2.0, -2.0),
        },
    ),
}
"""Tables 7.6 and 7.7: pitches (degrees; negative for trough roofs); largest net coefficients for
any blockage; least ones without blockage, and with full blockage.

Table 7.6: the largest are from BS 6399-2, table 13; the least without blockage equal it, those with
full blockage differ from it; "overall" as in a second implementation. Zone A at 10 degrees is -2.1
in copies of the Spanish DB SE-AE, table D.10, of SANS 10160-3, table 13, and of this table, and
-1.6 in one program: the safe value is taken. Table 7.7: "overall" at 20 degrees with blockage is
-1.3 in one program and -1.4 in another: the safe value is taken."""


TERRAINS = {"0": (0.003, 1.0), "I": (0.01, 1.0), "II": (0.05, 2.0), "III": (0.3, 5.0),
            "IV": (1.0, 10.0)}  # fmt: skip
"""Roughness length z_0 and least height z_min (m) of the terrain categories, table 4.1."""

HIGHEST = 200.0
"""Height (m) up to which 4.3.2 holds."""


class PeakPressure(float):
    """A peak velocity pressure (kN/m^2), from `peak_pressure`.

    Attributes
    ----------
    basis
        What it follows from, for reports.
    """

    basis: str

    def __new__(cls, value: float, basis: str = "") -> PeakPressure:
        """The number with its text."""
        new = super().__new__(cls, value)
        new.basis = basis
        return new


@checked
def peak_pressure(
    v_b: Positive,
    z: Positive,
    terrain: Literal["0", "I", "II", "III", "IV"],
    *,
    orography: Positive = 1.0,
    density: Positive = 1.25,
) -> PeakPressure:
    """Peak velocity pressure q_p(z), EN 1991-1-4, 4.3 to 4.5, in kN/m^2.

    Parameters
    ----------
    v_b
        Basic wind velocity, 4.2 (m/s).
    z
        Reference height (m), up to 200 m; of roofs mostly their top.
    terrain
        Category: "0" sea, "I" lakes and flat land, "II" low vegetation, "III" suburbs and woods,
        "IV" towns.
    orography
        Factor c_o, 4.3.3.
    density
        Of air (kg/m^3).

    Returns
    -------
    PeakPressure
        q_p = (1 + 7 I_v) rho v_m^2 / 2 (4.8), with v_m = c_r c_o v_b (4.3), c_r = k_r ln(z / z_0)
        (4.4), k_r = 0.19 (z_0 / 0.05)^0.07 (4.5), I_v = 1 / (c_o ln(z / z_0)) (4.7); turbulence
        factor 1. A number; as the pressure of `Scene.put_wind` it tells reports its site.

    Raises
    ------
    InputError
        An unknown category, a height beyond 200 m, or values that are not positive.

    Examples
    --------
    >>> round(codes.peak_pressure(26.0, 8.0, "III"), 2)
    0.66
    """
    checks.within("peak_pressure: z", z, 0.0, HIGHEST, "m")
    rough, least = TERRAINS[terrain]
    profile = np.log(max(z, least) / rough)
    mean = 0.19 * (rough / 0.05) ** 0.07 * profile * orography * v_b
    peak = float((1 + 7 / (orography * profile)) * density * mean**2 / 2000)
    site = f"v_b = {v_b:g} m/s, z = {z:g} m, terrain category {terrain}, c_o = {orography:g}"
    return PeakPressure(peak, f"EN 1991-1-4, 4.5: {site}, rho = {density:g} kg/m\u00b3")


def en1991_vault_zones(rise: float, height: float = 0.0) -> Zones:
    """Coefficients c_pe,10 of a vaulted roof, EN 1991-1-4, 7.2.8, figure 7.11.

    Parameters
    ----------
    rise
        f/d, 0.05 to 0.5.
    height
        h/d of the walls below; only 0, a vault on the ground, is available.

    Returns
    -------
    tuple
        Coefficients in the zones A, B and C. They approximate the figure's lines and were not
        compared with a copy of it; for a design read them there and pass ``zones=``.

    Raises
    ------
    InputError
        A rise outside the figure, or walls, for which the figure is ambiguous in part of its range:
        read it and pass ``zones=`` to `vault`.

    Examples
    --------
    >>> codes.en1991_vault_zones(0.5)
    (0.8, -1.2, -0.4)
    """
    rise = checks.within("en1991_vault_zones: f/d", rise, *VAULT_RISES)
    if checks.finite("en1991_vault_zones: h/d", height) != 0.0:
        raise InputError(
            f"en1991_vault_zones: h/d = {height:g} is not built in, only h/d = 0; read A, "
            "B and C off figure 7.11, where some rises have two values of A, and pass zones=."
        )
    a, b, c = (float(np.interp(rise, VAULT_RISES, ends)) for ends in VAULT_ENDS.values())
    return a, b, c


@checked
def asce7_arch_zones(rise: Positive, *, raised: bool, alternative: bool = False) -> Zones:
    """Coefficients C_p of an arched roof, ASCE 7-16 and 7-22, figure 27.3-3.

    Parameters
    ----------
    rise
        Ratio r of rise to span, up to 0.6.
    raised
        Whether the roof stands on walls, not on the ground.
    alternative
        Whether to take 6 r - 2.1 in the windward quarter, which is to be considered, too, for
        0.2 <= r <= 0.3.

    Returns
    -------
    tuple
        Coefficients in the windward quarter, central half and leeward quarter.

    Raises
    ------
    InputError
        A rise outside the figure, or outside the range of the alternative.

    Examples
    --------
    >>> codes.asce7_arch_zones(0.5, raised=False)
    (0.7, -1.2, -0.5)
    """
    checks.within("asce7_arch_zones: rise", rise, 0.0, 0.6)
    if alternative and not (raised and 0.2 <= rise <= 0.3):
        raise InputError(
            f"asce7_arch_zones: alternative, with the rise {rise:g} and raised = {raised!r}, is "
            "outside the range of 0.2 to 0.3 of raised roofs; leave it out."
        )
    if alternative:
        windward = 6 * rise - 2.1
    elif not raised:
        windward = 1.4 * rise
    elif rise < 0.2:
        windward = -0.9
    else:
        windward = 1.5 * rise - 0.3 if rise < 0.3 else 2.75 * rise - 0.7
    return windward, -0.7 - rise, -0.5


@dataclass(frozen=True)
class Footprint:
    """Dimensions of a roof in its current shape (length), along a direction in plan."""

    direction: tuple[float, float]
    start: tuple[float, float]  # its start along the direction and, from the left, across it
    depth: float  # d, along the direction
    breadth: float  # b, across it
    low: float  # z of its lowest and highest point
    high: float

    @property
    def rise(self) -> float:
        """f, from the lowest to the highest point (length)."""
        return self.high - self.low

    @property
    def computed(self) -> str:
        """Sizes for reports."""
        of_depth = f"f/d = {self.rise / self.depth:.4g}"
        return f"d = {self.depth:.4g}, b = {self.breadth:.4g}, {of_depth}"

    def parts(self, x: Array) -> tuple[Array, Array]:
        """Relative positions of points (3, n) along depth and breadth, 0 to 1."""
        c, s = self.direction
        along, across = c * x[0] + s * x[1], c * x[1] - s * x[0]
        return (along - self.start[0]) / self.depth, (across - self.start[1]) / self.breadth

    def arcs(self, x: Array) -> Array:
        """Positions of points (3, n) along a circular arc of this depth and rise, from -1 to 1."""
        half, rise = self.depth / 2, max(self.rise, EPSILON**0.25 * self.depth)
        radius = max((half**2 + rise**2) / (2 * rise), half)
        distance = half * np.clip(2 * self.parts(x)[0] - 1.0, -1.0, 1.0)
        return np.asarray(np.arcsin(distance / radius) / np.arcsin(half / radius))


def _footprint(call: str, scene: Scene, direction: PlanDirection, part: str | None) -> Footprint:
    """Dimensions of a scene's membrane, or of a part. Collective."""
    way = np.asarray(direction)
    c, s = map(float, way / np.hypot(*way))
    membrane = scene.membrane
    membrane.check_finite(call)
    if part is not None:
        checks.named("part", membrane.mesh.parts, part)
    x, y, z = _corners(scene, part).reshape(-1, 3).T
    values = np.array([c * x + s * y, c * y - s * x, z])
    low, high = np.empty(3), np.empty(3)
    membrane.comm.Allreduce(values.min(axis=1, initial=np.inf), low, op=MPI.MIN)
    membrane.comm.Allreduce(values.max(axis=1, initial=-np.inf), high, op=MPI.MAX)
    depth, breadth = float(high[0] - low[0]), float(high[1] - low[1])
    if depth <= 0.0 or breadth <= 0.0:
        raise InputError(f"{call}: the roof has no area in plan; set part= to the roof.")
    first, left, bottom = map(float, low)
    return Footprint((c, s), (first, left), depth, breadth, bottom, float(high[2]))


def _corners(scene: Scene, part: str | None) -> Array:
    """Corners (n, 3, 3) of this rank's cells, or of those of a part, in the current shape."""
    cells = np.arange(scene.mesh.mesh.topology.index_map(2).size_local)
    if part is not None:
        cells = np.flatnonzero(cells_of(scene.mesh, (part,))[: len(cells)])
    return scene.positions()[scene.V.dofmap.list[cells]]


@dataclass(frozen=True)
class ArchWind:
    """Wind on a vault or dome, EN 1991-1-4, 7.2.8, coefficients c_pe in the zones A, B and C.

    Attributes
    ----------
    roof
        Sizes of the roof along the wind.
    zones
        Coefficients A, B and C along the arc of a circle over the roof.
    stepped
        True for vaults: A on the windward quarter of the arc, B on the central half, C on the
        leeward quarter. False for domes: A, B and C at the windward edge, the crown and the leeward
        edge, linear between.
    """

    roof: Footprint
    zones: Zones
    stepped: bool = field(repr=False)

    def __call__(self, x: Array, n: Array) -> Array:
        """Coefficients (n,) at points (3, n)."""
        arc = self.roof.arcs(x)
        if self.stepped:
            return np.asarray(self.zones)[np.searchsorted((-0.5, 0.5), arc)]
        return np.interp(arc, (-1.0, 0.0, 1.0), self.zones)


@dataclass(frozen=True)
class CanopyWind:
    """Net wind on a canopy, EN 1991-1-4, 7.3, coefficients c_p,net by zones.

    Attributes
    ----------
    roof
        Sizes of the roof along its slope.
    zones
        Net coefficients of the zones A, B and C, on duopitch canopies also D; or "overall" alone.
    loaded
        Range of the depth that is loaded, within 0 to 1.
    """

    roof: Footprint
    zones: dict[str, float]
    loaded: tuple[float, float] = (0.0, 1.0)

    def __call__(self, x: Array, n: Array) -> Array:
        """Coefficients (n,) at points (3, n)."""
        along, across = self.roof.parts(x)
        low, high = self.loaded
        on = (along >= low - 8 * EPSILON) & (along <= high + 8 * EPSILON)
        if "overall" in self.zones:
            return np.where(on, self.zones["overall"], 0.0)
        found = np.full(len(along), self.zones["A"])
        places = {
            "D": np.abs(along - 0.5) < 0.1,
            "C": np.abs(along - 0.5) > 0.4,
            "B": np.abs(across - 0.5) > 0.4,
        }
        for zone, there in places.items():  # where two zones meet, the larger load counts
            value = self.zones.get(zone)
            if value is not None:
                more = there & ((found == self.zones["A"]) | (abs(value) > np.abs(found)))
                found[more] = value
        return np.where(on, found, 0.0)


def _checked_zones(call: str, zones: object) -> Zones:
    a, b, c = map(float, checks.vector(f"{call}: zones of A, B and C", zones))
    return a, b, c


@collective
def vault(
    scene: Scene,
    direction: PlanDirection,
    *,
    height: Finite = 0.0,
    zones: Zones | None = None,
    part: str | None = None,
) -> ArchWind:
    """Make wind across a vault in its current shape, EN 1991-1-4, 7.2.8. Collective.

    Zone A is the windward quarter of the arc, B the central half, C the leeward quarter.

    Parameters
    ----------
    scene
        Scene with the membrane.
    direction
        Direction (x, y) in plan towards which the wind blows, across the vault; for wind along it
        the figure has no coefficients.
    height
        Height h of the walls below the vault (length).
    zones
        Coefficients of A, B and C in place of `en1991_vault_zones`, such as for walls, from a
        national annex, or from `asce7_arch_zones`.
    part
        Part of the mesh for the roof; all of it by default.

    Returns
    -------
    ArchWind
        For `Scene.put_wind`.

    Raises
    ------
    InputError
        On all ranks: a direction without length, an unknown part, a roof that is not arched along
        the wind or a saddle, or a roof or walls outside the figure.

    Examples
    --------
    >>> scene.put_wind(0.8, codes.vault(scene, (1.0, 0.0)), name="wind x")
    """
    roof = _footprint("vault", scene, direction, part)
    _refuse_saddles(scene, roof, part)
    tall = height / roof.depth
    checks.within("vault: height / d", tall, 0.0, np.inf)
    if zones is None:
        return ArchWind(roof, en1991_vault_zones(roof.rise / roof.depth, tall), stepped=True)
    return ArchWind(roof, _checked_zones("vault", zones), stepped=True)


def _refuse_saddles(scene: Scene, roof: Footprint, part: str | None) -> None:
    """Refuse a vault that is not arched along the wind, or that a quadratic through its vertices
    bends the other way across it, or twists, by more than half as much. Collective."""
    centres = _corners(scene, part).mean(axis=1)
    s, t = (2 * one - 1 for one in roof.parts(centres.T))
    terms = np.stack([np.ones_like(s), s, t, s * s, s * t, t * t])
    sums = np.column_stack([terms @ terms.T, terms @ (centres[:, 2] - roof.low)])
    sums = scene.comm.allreduce(np.ascontiguousarray(sums))
    _, _, _, along, twist, across = np.linalg.lstsq(sums[:, :6], sums[:, 6], rcond=None)[0]
    if roof.rise <= 1e-3 * roof.depth or (along < 0.0 and max(across, abs(twist)) < -along / 2):
        return
    shape = "sags along the wind" if along >= 0.0 else "is a saddle or twisted"
    raise InputError(
        f"vault: the roof {shape}: it is {-along:.3g} higher in the middle than at its ends along "
        f"the wind, {-across:.3g} across it; figure 7.11 is for cylinders with wind across them. "
        "Use codes.wind_table with coefficients for this shape."
    )


@dataclass(frozen=True)
class TableWind:
    """Wind by a table over the roof, from `wind_table`.

    Attributes
    ----------
    roof
        Sizes of the roof along the wind.
    along, across
        Relative places of the table's rows along the wind and of its columns across it, 0 to 1.
    values : (rows, columns)
        Coefficients.
    linear
        Whether they are those of points, linear between them; else those of the zones around.
    """

    roof: Footprint
    along: tuple[float, ...]
    across: tuple[float, ...]
    values: Array
    linear: bool

    def __call__(self, x: Array, n: Array) -> Array:
        """Coefficients (n,) at points (3, n)."""
        places = self.roof.parts(x)
        rows, columns = (
            _share(np.asarray(known), at, self.linear)
            for known, at in zip((self.along, self.across), places, strict=True)
        )
        return np.einsum("rn,rc,cn->n", rows, self.values, columns)


def _share(known: Array, at: Array, linear: bool) -> Array:
    """Weights (m, n) of the m table entries at n places: by linear interpolation, or 1 of the zone
    that ends half way to the next entry."""
    found = np.zeros((len(known), len(at)))
    if not linear:
        found[np.searchsorted((known[1:] + known[:-1]) / 2, at), np.arange(len(at))] = 1.0
        return found
    for row, unit in zip(found, np.eye(len(known)), strict=True):
        row[:] = np.interp(at, known, unit)
    return found


@collective
def wind_table(
    scene: Scene,
    direction: PlanDirection,
    along: Sequence[float],
    across: Sequence[float],
    values: Sequence[Sequence[float]] | Array,
    *,
    linear: bool = False,
    part: str | None = None,
) -> TableWind:
    """Make wind by a table of your own over a roof in its current shape. Collective.

    For rounded halls, hypars and saddles, which codes leave to wind tunnels and literature.

    Parameters
    ----------
    scene, direction, part
        As for `vault`.
    along, across
        Relative places of the table's rows along the wind, from the windward edge 0 to the leeward
        one 1, and of its columns across it, from the right seen along the wind to the left (of wind
        along x: along y); increasing.
    values : (rows, columns)
        Coefficients c_p.
    linear
        Whether they are linear between these places; else each holds half way to the next.

    Returns
    -------
    TableWind
        For `Scene.put_wind`.

    Raises
    ------
    InputError
        On all ranks: places that do not increase from 0 to 1, values of another shape or not
        finite, or as for `vault`.

    Examples
    --------
    >>> ends = [[0.5, 0.6, 0.5], [-0.5, -0.9, -0.5], [-0.2, -0.3, -0.2]]
    >>> along_x = codes.wind_table(scene, (1, 0), (0.1, 0.5, 0.9), (0.1, 0.5, 0.9), ends)
    >>> scene.put_wind(0.8, along_x, name="wind x")
    """
    places = []
    for name, given in (("along", along), ("across", across)):
        checks.collection(f"wind_table: {name}", given, Sequence, f"{name}=(0.1, 0.5, 0.9)", 1)
        known = [checks.within(f"wind_table: {name}", one, 0.0, 1.0) for one in given]
        if sorted(set(known)) != known:
            raise InputError(f"wind_table: {name} = {known!r} does not increase; sort it.")
        places.append(tuple(known))
    table = np.asarray(values)
    if table.dtype.kind not in "fiu" or table.shape != tuple(map(len, places)):
        raise InputError(
            f"wind_table: values of shape {table.shape}; pass {len(along)} rows of {len(across)} "
            "numbers, one for each place."
        )
    if not np.isfinite(table).all():
        raise InputError("wind_table: one of values is not a finite number.")
    roof = _footprint("wind_table", scene, direction, part)
    return TableWind(roof, places[0], places[1], table, linear)


@collective
def dome(
    scene: Scene,
    direction: PlanDirection,
    *,
    zones: Zones | None = None,
    part: str | None = None,
) -> ArchWind:
    """Make wind on a dome in its current shape, EN 1991-1-4, 7.2.8, figure 7.12. Collective.

    Coefficients are constant on planes across the wind and linear along arcs from A over B to C.

    Parameters
    ----------
    scene, direction, part
        As for `vault`.
    zones
        Coefficients of A, B and C, read off figure 7.12 for f/d and h/d. The default is those of a
        hemisphere on the ground, the only ones known here.

    Returns
    -------
    ArchWind
        For `Scene.put_wind`; its `roof` has f and d.

    Raises
    ------
    InputError
        On all ranks: as for `vault`, or no zones for a dome that is not a hemisphere.

    Examples
    --------
    >>> along_x = codes.dome(scene, (1.0, 0.0), zones=(0.4, -0.9, -0.1))
    >>> scene.put_wind(0.8, along_x, name="wind")
    """
    roof = _footprint("dome", scene, direction, part)
    if roof.rise <= 0.0:
        raise InputError(f"dome: the roof has no rise, f = {roof.rise:g}; it is not a dome.")
    if zones is None and abs(roof.rise / roof.depth - 0.5) > 0.01:
        raise InputError(
            f"dome: f/d = {roof.rise / roof.depth:.3g} is not built in, only f/d = 0.5; "
            "read A, B and C off figure 7.12 and pass zones=."
        )
    found = HEMISPHERE if zones is None else _checked_zones("dome", zones)
    return ArchWind(roof, found, stepped=False)


@collective
def canopy(
    scene: Scene,
    direction: PlanDirection,
    kind: Literal["monopitch", "duopitch"],
    pitch: float,
    effect: Literal["down", "up"],
    *,
    blockage: float = 0.0,
    take: Literal["overall", "zones", "first", "second"] = "zones",
    part: str | None = None,
) -> CanopyWind:
    """Make net wind on a canopy, EN 1991-1-4, 7.3, tables 7.6 and 7.7. Collective.

    Parameters
    ----------
    scene, part
        As for `vault`.
    direction
        Direction (x, y) in plan, along the slope and across the ridge or trough.
    kind, pitch
        "monopitch" with 0 to 30 degrees, or "duopitch" with -20 (trough) to -5 or 5 to 30 degrees.
    effect
        "down" takes the largest coefficients, "up" the least.
    blockage
        Degree of blockage phi below the canopy, 0 to 1, 7.3(2).
    take
        "zones": local coefficients c_p,net, for fabric and fixings; "overall": force coefficient
        c_f everywhere, for the structure; "first" or "second": c_f on that half of a duopitch
        canopy only, 7.3(6).

    Returns
    -------
    CanopyWind
        For `Scene.put_wind`, positive downward. In corners the zone with the larger load counts.
        Compare the coefficients with your copy of the tables.

    Raises
    ------
    InputError
        On all ranks: a pitch or blockage outside the tables, or an unknown option.

    Examples
    --------
    >>> up = codes.canopy(scene, (1, 0), "duopitch", 12.0, "up", blockage=0.5)
    >>> scene.put_wind(0.7, up, name="wind up")
    """
    phi = checks.within("canopy: blockage", blockage, 0.0, 1.0)
    pitches, most, least, blocked = CANOPIES[kind]
    angle = checks.within(f"canopy: pitch of a {kind} roof", pitch, pitches[0], pitches[-1],
                           "degrees")  # fmt: skip
    if kind == "duopitch" and abs(angle) < 5.0:
        raise InputError(
            f"canopy: pitch = {angle:g} degrees of a duopitch roof is outside table 7.7, which "
            "covers 5 degrees and more or -5 and less; use a monopitch roof."
        )
    if kind == "monopitch" and take in ("first", "second"):
        raise InputError(f"canopy: take = {take!r} is for duopitch roofs; use 'overall'.")
    roof = _footprint("canopy", scene, direction, part)
    empty, full = (most, most) if effect == "down" else (least, blocked)
    names = [name for name in most if (name == "overall") != (take == "zones")]
    values = {
        name: float((1 - phi) * np.interp(angle, pitches, empty[name])
                    + phi * np.interp(angle, pitches, full[name]))
        for name in names
    }  # fmt: skip
    halves = {"first": (0.0, 0.5), "second": (0.5, 1.0)}
    return CanopyWind(roof, values, halves.get(take, (0.0, 1.0)))
