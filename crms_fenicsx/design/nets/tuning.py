"""Unstressed lengths of cables and bars for prescribed tensions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import least_squares

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Count, Positive, collective
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import ConvergenceError, InputError
from crms_fenicsx.model.bar import PlacedBar
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.versions import last_doubt
from crms_fenicsx.solver import Solver

Member = LaidCable | PlacedBar


class _Ended(Exception):  # noqa: N818 - no error: the end of a search
    """The wanted tensions are reached, or a load step failed, which is then the cause."""


def _tension(member: Member) -> float:
    return member.tension if isinstance(member, LaidCable) else member.force


@collective
def tune(
    solver: Solver, tensions: Mapping[Member, float], *, rtol: Positive = 1e-4, most: Count = 20
) -> dict[Member, float]:
    """Find the unstressed lengths of cables and bars for prescribed tensions under the loads.

    Collective. By `scipy.optimize.least_squares` with the derivatives of `Solver.sensitivities`.
    Each evaluation is a load step; the last one has the tensions.

    Parameters
    ----------
    solver
        A `Solver` at an equilibrium in which the cables and bars are in tension.
    tensions
        Tensions by cables and bars (force), mean ones for cables with clamps.
    rtol
        Largest relative difference.
    most
        Largest number of load steps.

    Returns
    -------
    dict
        The new unstressed lengths by cables and bars (length).

    Raises
    ------
    InputError
        On all ranks: no cable or bar of the scene, a tension that is not positive, a slack cable or
        bar, or tensions that no lengths give; the scene is then restored.

    Examples
    --------
    >>> nets.tune(solver, {cable: 40.0 for cable in scene.cables})
    """
    scene = solver.scene
    members = (*scene.cables, *scene.bars)
    checks.collection("tune: tensions", tensions, Mapping, "{cable: force, ...}", 1)
    for cable, force in tensions.items():
        if cable not in members:
            raise InputError(f"tune: {cable!r} is not a cable or bar of this scene.")
        checks.positive(f"tune: tension of {cable.name!r}", force)
        if not _tension(cable) > 0.0:
            raise InputError(f"tune: {cable.name!r} is not in tension; shorten it first.")
    cables = sorted(tensions, key=members.index)
    wanted = np.array([float(tensions[cable]) for cable in cables])
    first = np.array([cable.L0 for cable in cables])
    before = solver.snapshot()
    count = 0

    def errors(shares: Array) -> Array:
        nonlocal count
        if not np.allclose([cable.L0 for cable in cables], shares * first, rtol=1e-14, atol=0.0):
            count += 1
            try:
                solver.advance(L0=dict(zip(cables, shares * first, strict=True)))
            except (ConvergenceError, InputError) as error:  # such as for negative lengths
                raise _Ended from error
        found = np.array([_tension(cable) for cable in cables]) / wanted - 1
        if np.abs(found).max() <= rtol:
            raise _Ended
        return found

    def slopes(shares: Array) -> Array:
        errors(shares)  # in case the last step was not at these lengths
        return solver.sensitivities(cables, cables).values * first / wanted[:, None]

    with last_doubt(scene):
        cause = None
        try:
            least_squares(errors, np.ones(len(cables)), slopes, method="lm", max_nfev=most)
        except _Ended as end:
            cause = end.__cause__
            if cause is None:
                return {cable: cable.L0 for cable in cables}
        except InputError:  # there are no derivatives
            solver.restore(before)
            raise
        reached = np.array([_tension(cable) for cable in cables])
        k = int(np.abs(reached / wanted - 1).argmax())
        solver.restore(before)
        raise InputError(
            f"tune: no lengths give {cables[k].name!r} a tension of {wanted[k]:g}; the search "
            f"ended at {reached[k]:.6g} (load steps: {count}). Use tensions that balance the "
            "loads, or fewer."
        ) from cause
