"""The stress laws of `crms_fenicsx.materials`, compiled for the folded cells."""

from __future__ import annotations

import math

import numba

from crms_fenicsx.materials import TENSION_FIELD, UNSTRAINED


@numba.njit(cache=True)
def stress(law, p, e, s):  # type: ignore[no-untyped-def]
    """Energy per area; section forces (S11, S22, S12) into s. Returns (energy, state).

    `p` is `Membrane.parameters`, e the strain (E11, E22, 2 E12); state is 2 taut, 1 wrinkled,
    0 slack.
    """
    if law != TENSION_FIELD:
        energy = 0.0
        for i in range(3):
            s[i] = p[12 + i]
            for j in range(3):
                s[i] += p[3 * i + j] * e[j]
            energy += 0.5 * e[i] * (p[12 + i] + s[i])
        return energy, 2
    e0, e1, e2 = e[0] + p[9], e[1] + p[10], e[2] + p[11]
    rest = 0.0
    for i in range(3):
        rest += 0.5 * p[9 + i] * p[12 + i]
    mean, half, shear = 0.5 * (e0 + e1), 0.5 * (e0 - e1), 0.5 * e2
    radius = math.sqrt(half * half + shear * shear)
    larger, smaller = mean + radius, mean - radius
    if smaller + p[16] * larger >= 0.0:
        energy = 0.0
        for i in range(3):
            s[i] = p[3 * i] * e0 + p[3 * i + 1] * e1 + p[3 * i + 2] * e2
        energy = 0.5 * (e0 * s[0] + e1 * s[1] + e2 * s[2])
        return energy - rest, 2
    if larger > 0.0:
        t = p[15] * larger
        s[0] = 0.5 * t * (1 + half / radius)
        s[1] = 0.5 * t * (1 - half / radius)
        s[2] = 0.5 * t * shear / radius
        return 0.5 * t * larger - rest, 1
    s[0] = s[1] = s[2] = 0.0
    return -rest, 0


@numba.njit(cache=True)
def tangent(law, p, e, floor, C):  # type: ignore[no-untyped-def]
    """Consistent tangent (3, 3) into C, in wrinkling laws plus `floor` times the taut stiffness."""
    for i in range(3):
        for j in range(3):
            C[i, j] = p[3 * i + j]
    if law != TENSION_FIELD:
        return
    e0, e1, e2 = e[0] + p[9], e[1] + p[10], e[2] + p[11]
    mean, half, shear = 0.5 * (e0 + e1), 0.5 * (e0 - e1), 0.5 * e2
    radius = math.sqrt(half * half + shear * shear)
    larger, smaller = mean + radius, mean - radius
    if smaller + p[16] * larger >= -UNSTRAINED:
        for i in range(3):
            for j in range(3):
                C[i, j] *= 1 + floor
        return
    for i in range(3):
        for j in range(3):
            C[i, j] *= floor
    if larger > 0.0:
        # dyads along and across the tension line, paired with (E11, E22, 2 E12)
        c, s = half / radius, shear / radius
        along = (0.5 * (1 + c), 0.5 * (1 - c), 0.5 * s)
        across = (-0.5 * s, 0.5 * s, 0.5 * c)
        for i in range(3):
            for j in range(3):
                C[i, j] += p[15] * (along[i] * along[j] + larger / radius * across[i] * across[j])
