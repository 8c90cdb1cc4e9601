"""Estimate the prestress that stabilises the first Hessian of a solve."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.steps.loading import Target


def starting_prestress(system: System, target: Target, share: float) -> tuple[float, ...]:
    """Estimate the extra prestress in H0 for each of the first stages of a solve. Collective.

    A flat sheet has no stiffness against pressure. The stress that it will have is estimated from
    the load, 0.3 (p^2 L^2 E t)^(1/3), and from the movement; a stressed sheet gets none. Returns
    prestress of each stage (force per length), the last 0.
    """
    scene, size = system.scene, system.scene.membrane.size
    modulus = max(m.reference_modulus for m in scene.materials.values())
    travel = share * target.movements.travel
    loads = abs(scene.pressure) + system.added_force_per_area()
    loads += sum(abs(load.factor) * load.intensity for load in scene.loads)
    coming = 0.3 * (loads * size) ** (2 / 3) * modulus ** (1 / 3)
    coming = max(coming, 0.3 * modulus * (travel / size) ** 2)
    present = np.sqrt(max(2 * scene.energies.get("membrane", 0.0) * modulus, 0.0)) / size
    if present > 0.3 * coming:
        return (0.0,)
    return (coming, 0.1 * coming, 0.01 * coming, 0.0)
