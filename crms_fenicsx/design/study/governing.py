"""The combinations of a table that can govern, found from a few load steps.

The structure is nonlinear, so that effects of loads do not add up. Their sums are used as estimates
only: each load is applied alone, and the effects of all combinations are estimated from the
differences. For each limit state, missing member and leading load those with the largest estimate
of an effect are computed. If another one than that with the largest estimate turns out to govern,
all with a larger estimate than this one's are computed, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.steps.load_cases import Combination, back_to_now, checked_combinations
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Count, collective
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.combination_table import CombinationTable, Entry
from crms_fenicsx.model.strengths import ALL, SERVICE, SETTINGS, acting_loads
from crms_fenicsx.model.tolerances import SAME_VALUE
from crms_fenicsx.results.design_checks import LASTING
from crms_fenicsx.results.foundations import partition
from crms_fenicsx.results.output.report.results_tables import FINE
from crms_fenicsx.results.recovered_values import patches, recovered, reinforced
from crms_fenicsx.solver import Solver

Key = tuple[str, str]
"""What a value or an effect is, and the name of its member."""

Values = dict[Key, Array]
"""Values of a state that add up in a linear structure: forces, displacements."""

Effects = dict[Key, float]
"""Effects in a state: the larger, the worse."""


@collective
def combine_governing(
    solver: Solver, table: CombinationTable, *, steps: Count = 1
) -> dict[str, Combination]:
    """Solve those combinations of a table that can govern. Collective.

    Each load acts alone first, once for each setting (pressure, factor of the prestress, missing
    members) of the table. Sums of the changes estimate all combinations. For each limit state,
    missing member and kind of the leading load, those with the largest estimate of each effect are
    solved, and then those with a larger estimate than the one that governs. Effects are the tension
    of each cable, the forces of each bar, the mean force on each held edge, horizontal and vertical
    forces on each held point and joint, and section forces along warp and weft of each part over
    their design strengths; in service the tension of each cable, the deflection and the least
    prestress.

    The rest is left out with its estimate, and how far those of the solved ones were off, which
    reports list. Where that is much, as near a snap-through or in slack fabric, solve the whole
    table.

    Parameters
    ----------
    solver
        The solver, in the state that the combinations start from.
    table
        Combinations by `codes.combinations`, without those of which you know a reason
        (`CombinationTable.leave_out`).
    steps
        As of `Solver.combine`.

    Returns
    -------
    dict
        `Combination` by name, in the table's order; ``combination.table`` has those left out.

    Raises
    ------
    InputError
        As `Solver.combine`.
    ConvergenceError
        A combination, or a load alone, has no equilibrium; the message names it.

    Examples
    --------
    >>> table = codes.combinations(codes.en1990, ["weight"], ["snow", "wind x", "wind y"])
    >>> found = study.combine_governing(solver, table)
    >>> len(found), len(next(iter(found.values())).table.left_out)
    """
    checks.of_type("combine_governing: table", table, CombinationTable)
    checked_combinations(solver.scene, table)
    search = _Search(solver, table, steps)
    search.estimate()
    wanted = search.largest()
    while wanted:
        search.solve({name: table[name] for name in wanted})
        wanted = search.rivals()
    found = {name: search.found[name] for name in table if name in search.found}
    kept = CombinationTable(
        {name: table[name] for name in found}, table.actions, table.rules, table.formed,
        table.left_out | search.reasons,
    )  # fmt: skip
    return {name: replace(one, table=kept) for name, one in found.items()}


class _Search:
    """Combinations of a table, estimated and solved. Collective.

    Attributes: `found`, `computed`: solved combinations, and their effects; `estimates`: of all;
    `reasons`: why combinations need not be solved, set by `rivals`.
    """

    def __init__(self, solver: Solver, table: CombinationTable, steps: int) -> None:
        self.solver, self.steps = solver, steps
        self.table = checks.in_one_order(solver.comm, table)
        self.found, self.reasons = dict[str, Combination](), dict[str, str]()
        self.computed, self.estimates = dict[str, Effects](), dict[str, Effects]()
        groups = dict[object, list[str]]()
        for name, one in self.table.items():
            missing: Any = one.get("without", ())
            group = one.get("state"), tuple(missing), table.leading(name)
            groups.setdefault(group, []).append(name)
        self.groups = [*groups.values()]

    def solve(self, entries: Mapping[str, Entry]) -> dict[str, Values]:
        """Solve combinations, of the table or others, and read their values."""
        values = dict[str, Values]()
        solved = self.solver.combine(entries, steps=self.steps)
        with back_to_now(self.solver):
            for name, one in solved.items():
                self.solver.restore(one.snapshot)
                values[name] = _values(self.solver)
                if name in self.table:
                    self.found[name] = one
        for name in solved.keys() & self.table.keys():
            self.computed[name] = _effects(self.solver.scene, values[name], self.table[name])
        return values

    def estimate(self) -> None:
        """Estimate the effects of all combinations, setting by setting."""
        settings = list[tuple[dict[str, object], list[str]]]()
        for name, one in self.table.items():
            own = {key: x for key, x in one.items() if key in SETTINGS and key != "state"}
            known = next((names for other, names in settings if other == own), None)
            if known is None:
                settings.append((own, [name]))
            else:
                known.append(name)
        for _, names in settings:
            self._estimate(names)

    def _estimate(self, names: Sequence[str]) -> None:
        """Estimate combinations of one setting from their least factors, and each load alone."""
        before = self.solver.scene.factors  # of loads that a combination does not name
        acting = [acting_loads(before | self.table[name]) for name in names]
        loads = list(dict.fromkeys(load for one in acting for load in one))
        factors = np.array([[one.get(load, 0.0) for load in loads] for one in acting])
        least, most = factors.min(axis=0, initial=np.inf), factors.max(axis=0, initial=-np.inf)
        varied = np.flatnonzero(most > least)
        parts = (factors[:, varied] - least[varied]) / (most - least)[varied]
        # loads that change together are applied together
        parts, of = np.unique(parts.round(9), axis=1, return_inverse=True)
        entries = dict[str, Entry]()
        runs = [least]
        for k in range(parts.shape[1]):
            together = varied[of.ravel() == k]
            runs.append(least.copy())
            runs[-1][together] = most[together]
        keys = list[str]()
        for run in runs:
            given = {load: float(x) for load, x in zip(loads, run, strict=True)}
            same = [n for n, one in zip(names, acting, strict=True) if one == acting_loads(given)]
            words = " + ".join(f"{x:g} {load}" for load, x in given.items() if x)
            keys.append(same[0] if same else f"estimate: {words or 'no load'}")
            entries[keys[-1]] = self.table[keys[-1]] if same else self.table[names[0]] | given
        values = self.solve(entries)
        base, *alone = (values[key] for key in keys)
        for name, shares in zip(names, parts, strict=True):
            added = {
                key: first
                + sum(x * (one[key] - first) for x, one in zip(shares, alone, strict=True))
                for key, first in base.items()
            }
            self.estimates[name] = _effects(self.solver.scene, added, self.table[name])

    def keys(self, names: Sequence[str]) -> list[Key]:
        """Effects that matter in a group: those large enough to be shown in a report."""
        scales = dict[str, float]()
        for one in self.estimates.values():
            for (what, _), x in one.items():
                scales[what] = max(abs(x), scales.get(what, 0.0))
        return [
            key for key in self.estimates[names[0]]
            if max(abs(self.estimates[name][key]) for name in names) > FINE * scales[key[0]]
        ]  # fmt: skip

    def largest(self) -> list[str]:
        """Unsolved combinations with the largest estimate of an effect in their group."""
        wanted = {
            max(names, key=lambda name, key=key: self.estimates[name][key])  # type: ignore[misc]
            for names in self.groups for key in self.keys(names)
        }  # fmt: skip
        return [name for name in self.table if name in wanted and name not in self.found]

    def rivals(self) -> list[str]:
        """Unsolved combinations with a larger estimate than the one that governs, by what was
        computed, for an effect in their group. The others get their reasons."""
        wanted, self.reasons = set[str](), {}
        for names in self.groups:
            solved = [name for name in names if name in self.found]
            left, most = [name for name in names if name not in self.found], dict[str, float]()
            self.reasons |= dict.fromkeys(left, "without effects")
            for key in self.keys(names) if left else ():
                governs = max(solved, key=lambda name: self.computed[name][key])
                bound, size = self.estimates[governs][key], self.computed[governs][key]
                off = max(abs(self.computed[n][key] - self.estimates[n][key]) for n in solved)
                for name in left:
                    estimate = self.estimates[name][key]
                    if estimate > bound + SAME_VALUE * abs(size):
                        wanted.add(name)
                    elif bound > 0.0 and estimate / bound > most.get(name, 0.0):
                        most[name] = estimate / bound
                        words = " of ".join(x for x in key if x)
                        self.reasons[name] = (
                            f"{words} estimated at {estimate / bound:.0%} of that in {governs}; "
                            f"estimates of solved ones are off by up to {off / size:.0%} of it"
                        )
        return [name for name in self.table if name in wanted]


def _values(solver: Solver) -> Values:
    """Values of the present state, fields of this rank's part of the membrane. Collective."""
    scene, summary, results = solver.scene, solver.summary(), solver.results()
    found: Values = {("tension", x.name): np.array([x.largest]) for x in summary.cables.values()}
    found |= {("bar", x.name): np.array([x.force]) for x in summary.bars.values()}
    totals = dict(summary.joints)
    for name in partition(scene):  # which have no vertex in common
        one = summary.supports[name]
        if one.length:
            found["force per length", name] = np.array([one.mean])
        else:
            totals[name] = one.total
    found |= {("reaction", name): np.array(force) for name, force in totals.items()}
    base = scene.case.base
    if base is not None:
        found["deflection", ALL] = scene.u.x.array.reshape(-1, 3) - base.membrane.u
    dofs = scene.V.dofmap.list[: len(results.state)]
    patched = reinforced(scene.membrane.stress_free, patches(scene))[dofs]
    forces = {"warp": "warp", "weft": "weft"} if "warp" in results.names else {}
    forces |= {"force": "true force 1", "least force": "true force 2"}
    woven = ~scene.membrane.isotropic[:, None]
    for what, name in forces.items():
        out = patched | woven if what == "force" else patched
        at = np.where(out, np.nan, recovered(results, name))
        for part in [*scene.membrane.strengths] or [ALL]:
            found[what, part] = at[results.parts[part]] if part else at
    return found


def _effects(scene: Scene, values: Values, one: Entry) -> Effects:
    """Effects in a combination, from its values. Collective."""
    state, comm = str(one.get("state", "ULS")), scene.comm
    serves, found = state in SERVICE, dict[Key, float]()
    design = scene.design.of_fabric(state, acting_loads({**scene.factors, **one}))
    for (what, name), x in values.items():
        if what == "tension" or (what == "force per length" and not serves):
            found[what, name] = float(x[0])
        elif what == "bar" and not serves:
            for sense, size in {"tension": x[0], "compression": -x[0]}.items():
                found[sense, name] = max(float(size), 0.0)
        elif what == "reaction" and not serves:
            for sense, size in {"upward reaction": x[2], "downward reaction": -x[2]}.items():
                found[sense, name] = max(float(size), 0.0)
            found["horizontal reaction", name] = float(np.hypot(x[0], x[1]))
        elif what == "deflection" and serves:
            most = float(np.linalg.norm(x, axis=1).max(initial=0.0))
            found[what, name] = comm.allreduce(most, op=MPI.MAX)
        elif what in ("warp", "weft", "force") and not serves:
            most = float(np.max(x, initial=-np.inf, where=np.isfinite(x)))
            used = comm.allreduce(most, op=MPI.MAX) * (design[name].divisor if design else 1.0)
            if np.isfinite(used):
                found[f"{what} of its strength", name] = used
        elif what == "least force" and state == LASTING:
            least = float(np.min(x, initial=np.inf, where=np.isfinite(x)))
            found["loss of prestress", name] = -comm.allreduce(least, op=MPI.MIN)
    return found
