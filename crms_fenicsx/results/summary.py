"""Extreme values of an equilibrium: plain numbers for tables, the same on all ranks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.steps.load_cases import Combination, back_to_now
from crms_fenicsx.cabling.cables.deformed_surface import CurrentSurface
from crms_fenicsx.foundation.meshes.triangles import double_areas, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.foundation.runtime.checks import as_counted, span
from crms_fenicsx.foundation.runtime.errors import as_text
from crms_fenicsx.model.membrane_load import Pond
from crms_fenicsx.model.strengths import ALL, LIMIT_STATES, SERVICE, DesignStrength
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.model.versions import UNBALANCED, StateWarning
from crms_fenicsx.results.cable_and_bar_results import (
    BarResults,
    CableResults,
    ClampResults,
    Force,
    bar_results,
    cable_results,
    clamp_results,
    joint_reactions,
    triple,
)
from crms_fenicsx.results.design_checks import (
    LASTING,
    DesignCheck,
    Extreme,
    checks_of,
    extreme,
    governing_of,
    in_service,
)
from crms_fenicsx.results.hollows import Hollow, Hollows, find_hollows
from crms_fenicsx.results.membrane_results import MembraneResults, membrane_results
from crms_fenicsx.results.quantities import SUMMED_UP, Solved, shown_briefly
from crms_fenicsx.results.reactions import (
    HeldEnd,
    ends_at,
    held_ends,
    held_groups,
    held_lengths,
    held_there,
    support_forces,
)
from crms_fenicsx.results.recovered_values import (
    JudgedUtilisation,
    Patch,
    judged_utilisation,
    patches,
    reinforced,
)


@dataclass(frozen=True)
class PartSummary:
    """Summary of a part of the membrane, or of all of it.

    Attributes
    ----------
    area
        Stress-free area (length squared).
    slack, wrinkled
        Shares of that area.
    least, largest
        Cell values by name, such as "true force 1" or "warp"; the utilisation, with strengths only,
        is the recovered one at the vertices outside of reinforcement.
    change
        What finer cells may change of the largest utilisation, relative to it: largest difference
        between the utilisation of a cell and those recovered at its corners, in two rings of cells.
    """

    area: float
    slack: float
    wrinkled: float
    least: Mapping[str, Extreme]
    largest: Mapping[str, Extreme]
    change: float | None = None


@dataclass(frozen=True, repr=False)
class PatchSummary:
    """Reinforcement around a corner, where the utilisation of the plain fabric is not judged.

    Attributes
    ----------
    patch
        Its place, radius and reason.
    utilisation
        Largest recovered utilisation of the plain fabric in it, which grows as cells become finer.
    """

    patch: Patch
    utilisation: float

    def __repr__(self) -> str:
        at = ", ".join(f"{x:.4g}" for x in self.patch.at)
        return (
            f"radius {self.patch.radius:.4g} at ({at}), {self.patch.reason}; plain fabric "
            f"{self.utilisation:.3g}"
        )


@dataclass(frozen=True)
class SupportSummary:
    """Summary of a named group of held vertices.

    Attributes
    ----------
    directions
        Directions out of "xyz" in which all its vertices are held; "" for vertices in no such
        group.
    total, membrane
        Sum of all reactions, and the reaction on the membrane (force).
    parts
        Reactions on ends of cables and bars, and on loads at joints, by name (force).
    length
        Current length of its edges (length); 0 for points.
    mean, largest
        Magnitude of the membrane's reaction per length of held edges (force per length), mean along
        its edges and largest at a vertex.
    """

    directions: str
    total: Force
    membrane: Force
    parts: Mapping[str, Force]
    length: float
    mean: float
    largest: float


@dataclass(frozen=True, repr=False)
class Summary:
    """Extreme values of an equilibrium; ``print`` shows the most important ones.

    Attributes
    ----------
    pressure
        Inner pressure (force per area).
    factors
        Factors of loads and ponds, by name.
    energy
        Total potential energy (force x length).
    displacement, lowest, highest
        Largest displacement from the stress-free shape, and largest downward (negative) and upward
        displacements (length).
    parts
        By part of the mesh; "" is the whole membrane.
    cables, bars, ponds
        By name; ponds with levels and volumes.
    supports
        By group; groups may share vertices. `ALL_SUPPORTS` includes all groups, anchors and held
        joints, `OTHER_SUPPORTS` the vertices in no group that is held as a whole.
    joints
        Reactions of held joints and anchors of bars (force), by name.
    in_equilibrium
        Whether the scene was unchanged since its last load step; if not, forces and energy may be
        outdated and out of balance.
    warnings
        Warnings of load steps about this state, and of snap-throughs before it.
    clamps
        By name.
    state
        Limit state that it is for, of `Solver.combine`.
    design
        Design strengths of the fabric in this state, with their factors, by part; none in
        serviceability limit states, and without `Scene.set_strengths`.
    deflection
        Largest displacement from the state in operation, in which `Solver.combine` was called
        (length); None elsewhere.
    checks
        Effects against the design values and limits of `Scene.set_strengths`, `Scene.set_limits`
        and bars.
    hollows
        Hollows without drainage, the deepest first: place, depth and volume of the water in this
        shape, ignoring the deflection under it; see `Solver.check_ponding`.
    patches
        Reinforcement of the membrane's corners, by name; with strengths only.
    """

    pressure: float
    factors: Mapping[str, float]
    energy: float
    displacement: Extreme
    lowest: Extreme
    highest: Extreme
    parts: Mapping[str, PartSummary]
    cables: Mapping[str, CableResults]
    supports: Mapping[str, SupportSummary]
    bars: Mapping[str, BarResults]
    joints: Mapping[str, Force]
    ponds: Mapping[str, Pond]
    in_equilibrium: bool
    warnings: tuple[StateWarning, ...] = ()
    clamps: Mapping[str, ClampResults] = field(default_factory=dict)
    state: str = LIMIT_STATES[0]
    design: Mapping[str, DesignStrength] = field(default_factory=dict)
    deflection: Extreme | None = None
    checks: tuple[DesignCheck, ...] = ()
    hollows: tuple[Hollow, ...] = ()
    patches: Mapping[str, PatchSummary] = field(default_factory=dict)

    def __repr__(self) -> str:
        """A table with a row for each load, part, cable, bar and support."""
        rows = [
            *(("load", name, f"{factor:.4g}") for name, factor in self.factors.items()),
            ("pressure", "", f"{self.pressure:.4g}"),
            ("energy", "", f"{self.energy:.6g}"),
            ("displacement", "", repr(self.displacement)),
        ]
        if self.deflection is not None:
            rows.append(("deflection", self.state, repr(self.deflection)))
        rows = rows if self.in_equilibrium else [("state", "", UNBALANCED), *rows]
        for name, part in self.parts.items():
            shown = [*shown_briefly(part.least)[:2], *({"utilisation"} & part.least.keys())]
            values = [
                f"{one} {span([part.least[one].value, part.largest[one].value])}" for one in shown
            ]
            shares = f"{part.slack:.1%} slack, {part.wrinkled:.1%} wrinkled"
            if part.change is not None:
                values[-1] += f" (finer cells may change it by {part.change:.0%})"
            rows.append(("part" if name else "membrane", name, ", ".join([*values, shares])))
        for name, cable in self.cables.items():
            tension = "slack" if cable.slack else f"tension {span([cable.least, cable.largest])}"
            rows.append(("cable", name, f"{tension}, length {cable.length:.6g}"))
        rows += [("bar", name, f"force {bar.force:.4g}") for name, bar in self.bars.items()]
        rows += [("clamp", name, f"force {one.size:.4g}") for name, one in self.clamps.items()]
        for name, support in self.supports.items():
            rows.append(("support", name, f"total {as_text(support.total)}"))
        rows += [("reinforcement", name, repr(one)) for name, one in self.patches.items()]
        rows += [("rain stands", "", repr(hollow)) for hollow in self.hollows]
        rows += [("check", "" if x.passed else "not passed", repr(x)) for x in self.checks]
        rows += [("warning", one.kind, one.text) for one in self.warnings]
        wide = max(len(name) for _, name, _ in rows)
        return "\n".join(f"{kind:<14}{name:<{wide}}  {text}" for kind, name, text in rows)

    @property
    def membrane(self) -> PartSummary:
        """The whole membrane."""
        return self.parts[ALL]

    @property
    def reaction(self) -> Force:
        """Sum of all reactions of supports, anchors and held joints (force)."""
        return self.supports[ALL_SUPPORTS].total


@dataclass(frozen=True, repr=False)
class DesignTable:
    """The checks that govern, of `Solver.judge`.

    Attributes
    ----------
    rows
        Limit state, combination and check with the largest share, for each limit state, subject and
        member, in the order of the combinations.
    unjudged
        What has no design value in a combination that strengths judge: "fabric" or "fabric wall" of
        a part, "cable A1", "bar mast" (of a compressed one also the buckling curve); and fabric
        under loads that act longer than the leading ones of all their combinations, as "fabric
        under 'snow' for its k_long = 1.5".
    warnings
        Combinations whose states are doubtful, and the warning, such as of a snap-through.
    """

    rows: tuple[tuple[str, str, DesignCheck], ...]
    unjudged: tuple[str, ...] = ()
    warnings: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(cls, summaries: Mapping[str, Summary]) -> DesignTable:
        """The table of summaries by combination."""
        found: dict[tuple[str, str, str], list[tuple[str, str, DesignCheck]]] = {}
        for name, one in summaries.items():
            for check in one.checks:
                key = one.state, check.what, check.member
                found.setdefault(key, []).append((one.state, name, check))
        most = [governing_of(rows, lambda row: row[2].share) for rows in found.values()]
        rows = sorted(most, key=lambda row: LIMIT_STATES.index(row[0]))
        judged = [one for one in summaries.values() if one.state not in SERVICE]
        without = dict.fromkeys(name for one in judged for name in _without_design(one))
        without |= dict.fromkeys(_without_duration(judged))
        told = [(name, str(x)) for name, one in summaries.items() for x in one.warnings]
        return cls(tuple(rows), tuple(without), tuple(told))

    @property
    def passed(self) -> bool:
        """Whether all checks pass, in states without warnings."""
        return not self.warnings and all(check.passed for *_, check in self.rows)

    @property
    def governing(self) -> tuple[str, str, DesignCheck] | None:
        """The row with the largest share; None without any."""
        return governing_of(self.rows, lambda row: row[2].share) if self.rows else None

    def __repr__(self) -> str:
        """A table grouped by limit state."""
        lines, last = [], ""
        for state, name, check in self.rows:
            lines += [] if state == last else [state]
            last = state
            mark = "" if check.passed else "  NOT PASSED"
            lines.append(f"  {check!r}, {name.removeprefix(f'{state}: ')}{mark}")
        lines += [f"not judged: {', '.join(self.unjudged)}"] if self.unjudged else []
        lines += [f"doubtful: {name}: {warning}" for name, warning in self.warnings]
        return "\n".join(lines) or "no checks: set strengths or limits"


def _without_design(found: Summary) -> Iterator[str]:
    """Fabric, cables and bars of a state without a design value."""
    bare = [name for name, part in found.parts.items() if "utilisation" not in part.largest]
    yield from ["fabric"] if ALL in bare else [f"fabric {name}" for name in bare]
    yield from (f"cable {one.name}" for one in found.cables.values() if one.strength is None)
    yield from (f"bar {one.name}" for one in found.bars.values() if one.utilisation is None)


def _without_duration(judged: Iterable[Summary]) -> Iterator[str]:
    """Loads on the fabric whose duration no combination judges."""
    due, most = dict[tuple[str, str], float](), dict[tuple[str, str], float]()
    for part, design in (pair for found in judged for pair in found.design.items()):
        for load, k in design.durations.items():
            due[part, load] = k
            most[part, load] = max(design.factors["k_long"], most.get((part, load), 0.0))
    for (part, load), k in due.items():
        if most[part, load] < k:
            yield f"fabric{f' {part}' * bool(part)} under {load!r} for its k_long = {k:g}"


def judged(solver: Solved, combinations: Mapping[str, Combination]) -> DesignTable:
    """The table of combinations; the scene's state is restored. Collective."""
    found = {}
    with back_to_now(solver):
        for name, one in combinations.items():
            solver.restore(one.snapshot)
            found[name] = summary(solver.system)
    return DesignTable.of(found)


ALL_SUPPORTS, OTHER_SUPPORTS = "all supports", "other supports"


def summary(system: System) -> Summary:
    """Summarise the scene's present state. Collective."""
    scene = system.scene
    drains = scene.design.limits.slope is not None and scene.case.state == LASTING
    hollows = find_hollows(scene.net, drains)
    found, results, used = _without_checks(system, hollows)
    extremes = {
        key: extreme(scene.comm, values, at, largest=key[0] == "deflection")
        for key, (values, at) in in_service(scene, results).items()
    }
    checks = checks_of(scene, results, found, used, extremes, hollows.least)
    return replace(found, deflection=extremes.get(("deflection", ALL)), checks=checks)


def _without_checks(
    system: System, hollows: Hollows
) -> tuple[Summary, MembraneResults, JudgedUtilisation | None]:
    """The summary of the present state without its checks, the membrane's results, and its
    utilisation if there are strengths. Collective."""
    scene, results = system.scene, membrane_results(system)
    places = results.surface.points  # includes cable points on folded cells
    moved = places - results.surface.stress_free
    centres = _centres(results.surface, len(results.state))
    corners, used = dict[str, Patch](), None
    if results.design:
        corners = patches(scene)
        used = judged_utilisation(results, corners)
    parts = {ALL: _part(results, centres, used, None)}
    if len(results.parts) > 1:
        parts |= {
            name: _part(results, centres, used, name)
            for name in sorted(results.parts, key=as_counted)
        }
    found = Summary(
        scene.pressure,
        scene.factors,
        scene.energy,
        extreme(scene.comm, np.linalg.norm(moved, axis=1), places, largest=True),
        extreme(scene.comm, moved[:, 2], places, largest=False),
        extreme(scene.comm, moved[:, 2], places, largest=True),
        parts,
        cable_results(scene),
        _supports(system),
        bar_results(scene),
        joint_reactions(scene),
        {pond.name: pond for pond in scene.ponds},
        results.in_equilibrium,
        scene.warnings,
        clamp_results(scene),
        scene.case.state,
        results.design,
        hollows=hollows.hollows,
        patches={} if used is None else _patch_summaries(results, used, corners),
    )
    return found, results, used


def _patch_summaries(
    results: MembraneResults, used: JudgedUtilisation, corners: Mapping[str, Patch]
) -> dict[str, PatchSummary]:
    places = results.surface.stress_free[results.membrane.V.dofmap.list[: len(used.corners)]]
    found = {}
    for name, patch in corners.items():
        own = used.corners[reinforced(places, {name: patch}) & np.isfinite(used.corners)]
        most = results.comm.allreduce(float(own.max(initial=-np.inf)), op=MPI.MAX)
        if np.isfinite(most) and patch.radius > 0.0:
            found[name] = PatchSummary(patch, most)
    return found


def _part(
    results: MembraneResults, centres: Array, used: JudgedUtilisation | None, name: str | None
) -> PartSummary:
    comm, change = results.comm, None
    cells = np.arange(len(results.state)) if name is None else results.parts[name]
    slack, wrinkled, _ = results.shares(name)
    least, largest = {}, {}
    for one in SUMMED_UP:
        if one not in results.names:
            continue
        values, places = results.values(one)[cells], centres[cells]
        if used is not None and one == "utilisation":
            vertices = results.membrane.V.dofmap.list[cells]
            places = results.surface.points[vertices].reshape(-1, 3)
            values = used.judged[cells].ravel()
        if comm.allreduce(int(np.isfinite(values).sum())):
            least[one] = extreme(comm, values, places, largest=False)
            largest[one] = extreme(comm, values, places, largest=True)
    if used is not None and "utilisation" in largest:
        change = _change(results, used, cells, largest["utilisation"])
    area = comm.allreduce(float(results.stress_free_areas[cells].sum()))
    return PartSummary(area, slack, wrinkled, least, largest, change)


def _change(
    results: MembraneResults, used: JudgedUtilisation, cells: Indices, largest: Extreme
) -> float:
    """Largest spread of two rings of cells around the largest utilisation, relative to it; at an
    edge the first ring alone may have one value. Collective."""
    dofs = results.membrane.V.dofmap.list[cells]
    ids = results.membrane.vertex_ids[dofs]
    away = np.linalg.norm(results.surface.points[dofs] - np.array(largest.at), axis=2)
    there = away <= SAME_PLACE * results.membrane.size
    around = results.comm.allgather(np.unique(ids[there.any(axis=1)]))
    spread = used.spread[cells][np.isin(ids, np.concatenate(around)).any(axis=1)]
    most = float(np.max(spread, initial=0.0, where=np.isfinite(spread)))
    most = results.comm.allreduce(most, op=MPI.MAX)
    return most / largest.value if largest.value > 0.0 else 0.0


def _centres(surface: CurrentSurface, n: int) -> Array:
    """Centre of the largest facet of each of n cells, (n, 3)."""
    corners = surface.points[surface.triangles]
    order = np.lexsort((norm(double_areas(corners)), surface.parents))
    largest = np.searchsorted(surface.parents[order], np.arange(n), side="right") - 1
    return np.asarray(corners[order[largest]].mean(axis=1))


def _supports(system: System) -> dict[str, SupportSummary]:
    scene, forces = system.scene, support_forces(system)
    membrane, anchored = scene.membrane, held_ends(scene)
    n, lengths = len(forces), held_lengths(membrane)[: len(forces)]
    line = np.linalg.norm(forces / np.where(lengths > 0.0, lengths, np.inf), axis=1)
    others: Booleans = np.any(membrane.held[:n], axis=1)
    found = {}

    def add(
        name: str, directions: str, dofs: Indices | Integers, own: Array, ends: Sequence[HeldEnd]
    ) -> None:
        fabric, held = held_there(scene, forces[dofs], dofs, ends)
        parts = {key: triple(force) for key, force in held.items()}
        total = triple(sum(held.values(), fabric))
        sums = np.array([own.sum(), (own * line[dofs]).sum()])
        length, loaded = membrane.comm.allreduce(sums).tolist()
        largest = membrane.comm.allreduce(float(line[dofs].max(initial=0.0)), op=MPI.MAX)
        mean = loaded / length if length > 0.0 else 0.0
        found[name] = SupportSummary(
            directions, total, triple(fabric), parts, length, mean, largest
        )

    for name, (directions, dofs) in held_groups(membrane).items():
        ends = ends_at(scene, dofs, anchored)
        own, dofs = np.zeros(len(forces)), dofs[dofs < n]
        if name in membrane.mesh.edges:
            own = held_lengths(membrane, name)[:n].max(axis=1)
        add(name, directions, dofs, own[dofs], ends)
        others[dofs] = False
    every = lengths.max(axis=1)
    if membrane.comm.allreduce(int(others.sum())):
        rest = np.flatnonzero(others)
        add(OTHER_SUPPORTS, "", rest, every[others], ends_at(scene, rest, anchored))
    add(ALL_SUPPORTS, "", np.arange(n), every, anchored)
    return found
