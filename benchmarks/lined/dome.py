"""The dome of `demos/air_dome.py` with 28 cables: cost beside the bare roof and folded cables."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from roofs import cap, covered, great_circles

from crms_fenicsx import Cable, Solver, meshes, nets
from lined import timed
from lined.mirrored import CABLES, MESHES

PRESSURES = (0.3, 0.5)
FOLDS = 118.0  # unknowns of fold points of 28 cables, over the root of the mesh's unknowns


def net_on(mesh: meshes.MembraneMesh) -> nets.Net:
    """The dome's net."""
    lines = great_circles(CABLES)
    families = [[line for name, line in lines.items() if name[0] == one] for one in "AB"]
    return nets.from_paths(covered(mesh), families)


@dataclass
class Steps:
    """Load steps of a dome: CPU seconds of laying and of each step, counts and tensions of each."""

    laying: float
    seconds: list[float]
    counts: list[tuple[int, int]]
    tensions: list[list[float]]
    unknowns: int


def inflated(mesh: meshes.MembraneMesh, net: nets.Net | None, slide: bool = True) -> Steps:
    """Lay a net along lines of a dome's mesh, if there is one, and inflate it."""
    scene = covered(mesh)
    solver = Solver(scene, slide=slide)
    laying, _ = timed(lambda: scene.lay_net(net, Cable(EA=600e3)) if net else None)
    found = Steps(laying, [], [], [], 0)
    for pressure in PRESSURES:
        spent, step = timed(lambda p=pressure: solver.advance(pressure=p))  # type: ignore[misc]
        found.seconds.append(spent)
        found.counts.append((step.outcome.factorizations, step.outcome.evaluations))
        found.tensions.append([cable.tension for cable in scene.cables])
    found.unknowns = 3 * solver.system.unknowns.n_global
    return found


def dome(unknowns: float, repeats: int) -> None:
    """Cables along lines that are held and that slide, against the bare roof of the same mesh."""
    first = cap(unknowns)
    net = net_on(first)
    ways = {"bare roof": (None, True), "lines held": (net, False), "lines slide": (net, True)}
    cutting, runs = [], {name: list[Steps]() for name in ways}
    for _ in range(repeats):
        spent, mesh = timed(lambda: meshes.along(first, net.paths))
        cutting.append(spent)
        for name, way in ways.items():
            runs[name].append(inflated(mesh, *way))
    print("\ndome            unknowns    s at .3      .5    fact.      eval.     ratio  laying"
          "    mean T          mirrored")  # fmt: skip
    bare = np.array([one.seconds for one in runs["bare roof"]]).sum(axis=1)
    for name, own in runs.items():
        seconds = np.array([one.seconds for one in own])
        counts = ["+".join(map(str, each)) for each in zip(*own[0].counts, strict=True)]
        said = f"{name:16}{own[0].unknowns:8}{np.median(seconds[:, 0]):12.2f}"
        said += f"{np.median(seconds[:, 1]):8.2f}{counts[0]:>9}{counts[1]:>11}"
        if own[0].tensions[0]:
            families = np.reshape(own[0].tensions, (2, 2, CABLES))  # of both steps
            mirrored = unlike(families)
            ratio = np.median(seconds.sum(axis=1) / bare)
            laying = statistics.median(one.laying for one in own)
            said += f"{ratio:10.2f}{laying:8.2f}"
            said += "".join(f"{T:9.2f}" for T in families.mean(axis=(1, 2)))
            said += "".join(f"{part:9.5f}" for part in mirrored)
        print(said, flush=True)
    print(f"cutting and spreading {statistics.median(cutting):.2f} s", flush=True)


def unlike(families: NDArray[np.float64]) -> NDArray[np.float64]:
    """The largest difference of tensions (2, 2, n) of mirrored cables, in both steps (2,)."""
    return np.asarray(np.abs(families / families[:, :, ::-1] - 1).max(axis=(1, 2)))


def mirrored(unknowns: float) -> None:
    """Tensions of mirrored cables on several meshes of the dome."""
    print("\nmesh of the dome, unknowns, factorisations, mean T, mirrored tensions apart by")
    for name, make in MESHES.items():
        mesh = make(unknowns)
        own = inflated(mesh, net_on(mesh))
        families = np.reshape(own.tensions, (2, 2, CABLES))
        print(f"{name:12}{own.unknowns:9}  {own.counts[0][0]}+{own.counts[1][0]}"
              + "".join(f"{T:10.2f}" for T in families.mean(axis=(1, 2)))
              + "".join(f"{part:10.4%}" for part in unlike(families)), flush=True)  # fmt: skip


def cost(sizes: Sequence[float]) -> None:
    """How the time of both load steps grows with the number of unknowns."""
    found = []
    print("\nunknowns  cutting   laying   s at .3     .5   factorisations")
    for unknowns in sizes:
        first = cap(unknowns)
        net = net_on(first)
        cutting, mesh = timed(lambda m=first, n=net: meshes.along(m, n.paths))  # type: ignore[misc]
        own = inflated(mesh, net)
        found.append((own.unknowns, sum(own.seconds)))
        counts = "+".join(str(count) for count, _ in own.counts)
        print(f"{own.unknowns:8}{cutting:9.2f}{own.laying:9.2f}"
              + "".join(f"{t:9.2f}" for t in own.seconds) + f"   {counts}", flush=True)  # fmt: skip
    exponent = np.polyfit(*np.log(found).T, 1)[0]
    print(f"time grows with the number of unknowns to the power {exponent:.2f}", flush=True)


def folded(unknowns: float) -> None:
    """The dome's net across cells and along lines, with about as many unknowns."""
    lined = cap(unknowns)
    net = net_on(lined)
    runs = {"along lines": inflated(meshes.along(lined, net.paths), net)}
    root = np.sqrt(FOLDS**2 / 4 + runs["along lines"].unknowns) - FOLDS / 2
    plain = cap(float(root**2))
    runs["folded"] = inflated(plain, net_on(plain))
    print("\ndome           unknowns  laying   s at .3     .5     mean T          mirrored")
    for name, own in runs.items():
        families = np.reshape(own.tensions, (2, 2, CABLES))
        print(f"{name:12}{own.unknowns:11}{own.laying:8.2f}"
              + "".join(f"{t:9.2f}" for t in own.seconds)
              + "".join(f"{T:9.2f}" for T in families.mean(axis=(1, 2)))
              + "".join(f"{part:9.3%}" for part in unlike(families)), flush=True)  # fmt: skip
    spent = [np.array([own.laying, *own.seconds]) for own in runs.values()]
    print(f"folded / along lines: both steps {spent[1][1:].sum() / spent[0][1:].sum():.1f}, with "
          f"laying {spent[1].sum() / spent[0].sum():.1f}", flush=True)  # fmt: skip
