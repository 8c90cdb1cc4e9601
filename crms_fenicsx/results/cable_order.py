"""Fabrication lengths of cables."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import File, Finite, collective
from crms_fenicsx.foundation.runtime.arrays import floats
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.foundation.runtime.files import absolute, replaced
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.temperature import MOST_CHANGE, STEEL, check_expansion, growth


@dataclass(frozen=True)
class CableOrder:
    """Fabrication lengths of a cable.

    Attributes
    ----------
    name
        Name of the cable.
    EA
        Axial stiffness (force).
    L0
        Unstressed length between the ends, at the model's temperature (length).
    tension
        Tension during measurement (force).
    length
        Length between the ends under that tension and at the measuring temperature (length).
    clamps
        Names of the clamps on the cable, from start to end.
    spacings
        Distances from the start to the first clamp, between clamps, and to the end, measured as
        `length` is (length).
    cut
        `length` plus the allowances at both ends (length).
    """

    name: str
    EA: float
    L0: float
    tension: float
    length: float
    clamps: tuple[str, ...]
    spacings: tuple[float, ...]
    cut: float


@dataclass(frozen=True)
class Order:
    """Fabrication lengths of a scene's cables, and the measuring conditions.

    Attributes
    ----------
    cables
        `CableOrder` by cable name.
    temperature
        Measuring temperature minus the model's (kelvin).
    expansion
        Coefficient of thermal expansion (per kelvin), as given; None: that of each cable.
    allowance
        Allowances at the start and at the end of each cable (length).
    comm
        Communicator of the scene.
    """

    cables: Mapping[str, CableOrder]
    temperature: float
    expansion: float | None
    allowance: tuple[float, float]
    comm: MPI.Intracomm

    COLUMNS = (
        "Cable", "EA", "Unstressed length", "Measured at tension", "Length there", "From", "To",
        "Spacing", "From the start", "Cut length",
    )  # fmt: skip

    def rows(self) -> list[tuple[str | float, ...]]:
        """One row for each segment between clamps, with the columns `COLUMNS`."""
        found: list[tuple[str | float, ...]] = []
        for one in self.cables.values():
            marks = ["start", *one.clamps, "end"]
            passed = floats(np.cumsum(one.spacings))
            head = (one.name, one.EA, one.L0, one.tension, one.length)
            found += [
                (*head, *marks[k : k + 2], spacing, passed[k], one.cut)
                for k, spacing in enumerate(one.spacings)
            ]
        return found

    @collective
    def write(self, filename: File) -> None:
        """Write a CSV file with full precision. Collective.

        Parameters
        ----------
        filename
            Name of the file; an existing file is replaced.

        Raises
        ------
        InputError
            On all ranks: a file that cannot be written.
        """
        path = absolute(filename, self.comm)
        with raised_together(self.comm):
            if self.comm.rank == 0:
                with replaced(path) as partial, open(partial, "w", encoding="utf-8") as file:
                    writer = csv.writer(file, lineterminator="\n")  # quotes names with commas
                    writer.writerows([self.COLUMNS, *self.rows()])


@collective
def lengths_to_order(
    scene: Scene,
    *,
    tension: float | Mapping[str, float] = 0.0,
    temperature: Finite = 0.0,
    expansion: Finite | None = None,
    allowance: float | tuple[float, float] = 0.0,
) -> Order:
    """Fabrication lengths and clamp marks of a scene's cables. Collective.

    Parameters
    ----------
    scene
        A scene with cables.
    tension
        Tension during measurement, for all cables or by name (force).
    temperature
        Measuring temperature minus the model's (kelvin).
    expansion
        Coefficient of thermal expansion of cables without one (per kelvin), by default that of
        steel, 1.2e-5.
    allowance
        Allowance at each end, or at the start and at the end (length).

    Returns
    -------
    Order
        The lengths: `Order.write` writes them to a CSV file, and `Solver.report` takes them.

    Raises
    ------
    InputError
        On all ranks: a scene without cables, an invalid number, a tension below 0 or above 0.1 EA,
        a difference of more than 200 K, an expansion of more than 0.001 per kelvin, or one beside
        other ones of the cables.

    Examples
    --------
    >>> order = nets.lengths_to_order(scene, tension=5.0, temperature=-15, allowance=0.4)
    >>> order.cables["A1"].spacings
    >>> order.write("cables.csv")
    """
    call = "lengths_to_order"
    if not scene.cables:
        raise InputError(f"{call}: the scene has no cables; lay some with scene.lay_cable(...).")
    given = tension if isinstance(tension, Mapping) else {c.name: tension for c in scene.cables}
    forces = {
        scene.cable(name).name: checks.finite(f"{call}: tension of {name!r}", force)
        for name, force in given.items()
    }
    both = allowance if isinstance(allowance, tuple) else (allowance, allowance)
    if len(both) != 2:
        raise InputError(f"{call}: allowance = {allowance!r}; pass one, or (start, end).")
    ends = [checks.finite(f"{call}: allowance", one) for one in both]
    _refuse_impossible(call, scene, forces, temperature, expansion)
    found = {
        cable.name: _order(
            scene, cable, forces.get(cable.name, 0.0), temperature, expansion, sum(ends)
        )
        for cable in scene.cables
    }
    return Order(found, temperature, expansion, (ends[0], ends[1]), scene.comm)


def _refuse_impossible(
    call: str,
    scene: Scene,
    forces: Mapping[str, float],
    temperature: float,
    expansion: float | None,
) -> None:
    """Refuse tensions and temperatures at which no cable is measured: they are in another unit, or
    absolute."""
    for name, force in forces.items():
        EA = scene.cable(name).cable.EA
        if not 0.0 <= force <= 0.1 * EA:
            raise InputError(
                f"{call}: tension of {name!r} = {force!r}, a strain of {force / EA:.3g} with its "
                f"EA = {EA:.6g}; pass its tension when it is measured, from 0 to 0.1 EA."
            )
    if abs(temperature) > MOST_CHANGE:
        raise InputError(
            f"{call}: temperature = {temperature!r}; pass the difference to the model's "
            f"temperature in kelvin, from -{MOST_CHANGE:g} to {MOST_CHANGE:g}."
        )
    check_expansion(call, expansion)
    for cable in scene.cables:
        if expansion is not None and cable.cable.expansion not in (None, expansion):
            raise InputError(
                f"{call}: expansion = {expansion:g}, but {cable.name!r} has expansion = "
                f"{cable.cable.expansion:g} of its own; leave one out."
            )


def _order(
    scene: Scene, cable: LaidCable, tension: float, temperature: float, expansion: float | None,
    more: float,
) -> CableOrder:  # fmt: skip
    """Fabrication lengths of one cable."""
    own = cable.cable.expansion
    L0 = cable.L0 / growth(own, scene.loads.warming(cable))
    steel = STEEL if expansion is None else expansion
    warm = growth(steel if own is None else own, temperature)
    clamps = sorted(
        (clamp.at[clamp.cables.index(cable.name)], clamp.name)
        for clamp in scene.clamps
        if cable.name in clamp.cables
    )
    length = L0 * (1 + tension / cable.cable.EA) * warm
    spacings = length * np.diff([0.0, *(at for at, _ in clamps), 1.0])
    return CableOrder(
        cable.name, cable.cable.EA, L0, tension, length, tuple(name for _, name in clamps),
        tuple(floats(spacings)), length + more,
    )  # fmt: skip
