"""When a structure counts as free of stress."""

from __future__ import annotations

NO_STRAIN = 1e-8
"""Strain below which a cable, a bar or the membrane counts as unstressed: the solver's tolerance is
as coarse."""


def is_unstressed(forces: float, energy: float, stiffness: float, size: float) -> bool:
    """Whether forces and energy are at most those of a strain of `NO_STRAIN`.

    Where nothing loads a slack membrane all forces fade together, so that none becomes small beside
    the others. Forces alone can also cancel in a stressed state, and the energy of prestress is
    zero where the membrane is laid: both count.

    Parameters
    ----------
    forces, energy
        Scale of the forces (force) before they cancel, and potential energy (force x length).
    stiffness, size
        Force at a strain of 1, 0 where loads set the scale, and size (length) of the structure.
    """
    tiny = NO_STRAIN * stiffness
    return forces <= tiny and energy <= 0.5 * NO_STRAIN * tiny * size
