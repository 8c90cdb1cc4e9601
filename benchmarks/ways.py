"""Random scenes, each loaded along several paths: one equilibrium, and a fixed point.

Without friction the equilibrium of cables and membrane does not depend on the load path. A scene
follows from its number: a random mesh, one cable or two crossing ones, in half of the scenes along
mesh lines, of lengths from nearly slack to tight, under pressure. Each is solved

direct
    laid on the stress-free membrane, and inflated,
steps
    inflated in 5 steps,
after
    laid on the inflated membrane,
beyond
    inflated with three times the pressure, and let down,
out
    with an end of the first cable moved along the boundary by up to two cells, and back,
detour
    laid some cells beside its place;

and then once more under the same load. Tolerances: W to 1e-5 of itself and T to 1e-3 between paths,
W to 1e-9 when nothing changes.

    ./run python benchmarks/ways.py --scenes 0 300 [--to FILE]
    ./run python benchmarks/ways.py --report FILE [FILE ...]

For each scene: the largest differences between paths, of W relative to the sum of the magnitudes of
all energies and to |W|, and of T; the change under the same load; evaluations. A table at the end
counts the paths within tolerance of the one with the least energy.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from fuzzing import scenes
from fuzzing.checks import kind_of
from fuzzing.runs import HangError, limited
from fuzzing.scenes import WIDTH, Seeded
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes, nets
from crms_fenicsx.foundation.runtime import errors
from crms_fenicsx.foundation.runtime.arrays import Array

sys.path.append(str(Path(__file__).parents[1] / "tests" / "scenes"))  # their meshes
from cabled_square import rotated_lattice

HALF = WIDTH / 2
WAYS = ("direct", "steps", "after", "beyond", "out", "detour")
GRIDS = ("right", "left", "union", "crossed")
ON_LINES = (*GRIDS, "turned", "embedded", "polar")
ANYHOW = (*GRIDS, "turned", "polar", "unstructured", "refined", "jiggled", "cap", "hall")
W_BAR, T_BAR, AGAIN_BAR = 1e-5, 1e-3, 1e-9
SLACK = 0.2
"""Tension to S h up to which a cable may be in tension that should be slack; see README.md."""
SECONDS = 40


@dataclass(frozen=True)
class Setting:
    """A scene; the paths of its cables (k, 2) or (k, 3), and by how much they are too short."""

    number: int
    kind: str
    on_lines: bool
    n: int
    mesh: Callable[[MPI.Intracomm], meshes.MembraneMesh]
    nu: float
    pressure: float
    paths: tuple[Array, ...]
    shorter: tuple[float, ...]
    out: tuple[float, float, float]

    @property
    def h(self) -> float:
        """Size of a cell."""
        return WIDTH / self.n


@dataclass
class Result:
    """What the ways have led to: W, T of each cable, by way; and what moved by the same load.

    `tense` is the least T / S h of a cable, S the membrane's largest section force and h the size
    of a cell, and `lifted` the most nodes off the membrane, of all ways.
    """

    number: int
    kind: str
    on_lines: bool
    n: int
    cables: int
    shorter: float
    W: dict[str, float] = field(default_factory=dict)
    T: dict[str, list[float]] = field(default_factory=dict)
    moved: dict[str, float] = field(default_factory=dict)
    tightened: dict[str, float] = field(default_factory=dict)
    scale: float = 1.0
    tense: float = np.inf
    lifted: int = 0
    evaluations: int = 0
    again_evaluations: int = 0
    seconds: float = 0.0
    refused: dict[str, str] = field(default_factory=dict)

    @property
    def best(self) -> str:
        """The way to the least energy."""
        return min(self.W, key=lambda way: self.W[way])

    def above(self, way: str) -> float:
        """Energy above the least (force x length)."""
        return self.W[way] - self.W[self.best]

    def tighter(self, way: str) -> float:
        """Difference of tensions from those of the least energy, relative to the larger."""
        pairs = zip(self.T[way], self.T[self.best], strict=True)
        return max(abs(a - b) / max(a, b, 1e-300) for a, b in pairs)

    def within(self, way: str) -> bool:
        """Whether a way has led to the equilibrium with the least energy."""
        least = abs(self.W[self.best])
        return self.above(way) <= W_BAR * least and self.tighter(way) <= T_BAR

    def rests(self, way: str) -> bool:
        """Whether the same load has moved nothing."""
        return way in self.moved and self.moved[way] <= AGAIN_BAR

    @property
    def worst(self) -> tuple[float, float, float]:
        """Largest differences of W to the sum of kinds and to |W|, and of T."""
        if not self.W:
            return 0.0, 0.0, 0.0
        dW = max(map(self.above, self.W))
        return dW / self.scale, dW / abs(self.W[self.best]), max(map(self.tighter, self.W))


def setting(number: int, n: int | None = None) -> Setting:
    """The scene with a number; on a mesh of n cells a side instead of its own."""
    draws, on_lines = Seeded(number), number % 2 == 0
    kinds = ON_LINES if on_lines else ANYHOW
    kind = kinds[draws.integer(0, len(kinds) - 1)]
    sizes = (10, 11, 13, 16, 16, 20, 20, 25, 33)
    own = sizes[draws.integer(0, len(sizes) - 1)]
    n = own if n is None else n
    crossed, seed = draws.real(0, 1) < 0.25, draws.integer(0, 10**6)
    angle, height = draws.real(0, np.pi), draws.real(12.0, 28.0)
    path, along = _path(draws, kind, on_lines, own, angle, height)
    paths = [path, _other(draws, kind, on_lines, own, angle, height)] if crossed else [path]
    flat = kind not in ("polar", "cap", "hall")
    if draws.real(0, 1) < 0.35 and flat:
        a, b = (np.append(p, draws.real(-1.0, 3.0)) for p in (path[0], path[-1]))
        along = np.append(along, 0.0)
        paths[0] = np.array([a - draws.real(1, 6) * along, b + draws.real(1, 6) * along])
    shorter = [10 ** draws.real(-3.7, -1.5) for _ in paths]
    outward = path[0] / np.linalg.norm(path[0])
    if kind not in ("polar", "cap"):
        edge = np.abs(path[0]) / (30.0 if kind == "hall" else HALF, HALF)
        outward = np.sign(path[0]) * (edge == edge.max())
    aside = np.array([-outward[1], outward[0]])
    aside *= -1.0 if path[0] @ aside > 0.0 else 1.0  # away from corners
    move = draws.real(0.3, 2.0) * WIDTH / own * aside
    if draws.real(0, 1) < 0.5:
        move = move + draws.real(0.0, 1.5) * outward
    return Setting(
        number, kind, on_lines, n, lambda comm: _mesh(comm, kind, n, seed, angle, height, path),
        draws.real(0.0, 0.4), draws.real(0.004, 0.03), tuple(paths), tuple(shorter),
        (float(move[0]), float(move[1]), 0.0),
    )  # fmt: skip


def _path(
    draws: Seeded, kind: str, on_lines: bool, n: int, angle: float, height: float
) -> tuple[Array, Array]:
    """A path across the membrane, and its direction."""
    if kind in ("polar", "cap"):
        offset = 0.0 if on_lines else draws.real(-22.0, 22.0)
        path = nets.great_circle(HALF, height, 0.0 if on_lines else angle, offset)
    elif kind == "hall":
        path = np.array([(-30.0, draws.real(-40, 40)), (30.0, draws.real(-40, 40))])
    elif kind == "turned" and on_lines:  # along a row of the lattice
        row = draws.integer(-(n // 3), n // 3) * np.sqrt(0.75) * WIDTH / n
        along = np.array([np.cos(angle), np.sin(angle)])
        path = _across(row * np.array([-along[1], along[0]]), along)
    elif on_lines and kind != "embedded":
        k, way = draws.integer(1, n - 1), draws.integer(0, 2)
        y, slope = k * WIDTH / n - HALF, 1.0 if kind != "left" else -1.0
        diagonal = _across(np.array([-HALF, y]), np.array([1.0, slope]))
        row = way == 0 or (kind == "union" and k % 2) or np.ptp(diagonal) < HALF
        path = np.array([(-HALF, y), (HALF, y)]) if row else diagonal
    else:
        path = np.array([(-HALF, draws.real(-42, 42)), (HALF, draws.real(-42, 42))])
    along = (path[-1] - path[0]) / np.linalg.norm(path[-1] - path[0])
    return path, along


def _across(at: Array, along: Array) -> Array:
    """Where a line meets the square's sides."""
    with np.errstate(divide="ignore"):
        back, ahead = np.sort([(-HALF - at) / along, (HALF - at) / along], axis=0)
    return np.clip([at + back.max() * along, at + ahead.min() * along], -HALF, HALF)


def _other(draws: Seeded, kind: str, on_lines: bool, n: int, angle: float, height: float) -> Array:
    """A path that crosses the first one."""
    if kind in ("polar", "cap"):
        turned = draws.real(1.1, 2.0) + (0.0 if on_lines else angle)
        return nets.great_circle(HALF, height, turned, draws.real(-15.0, 15.0))
    a, b = draws.real(-0.7, 0.7), draws.real(-0.7, 0.7)
    if on_lines and kind in GRIDS:
        a = b = 2 * round((a + 1) / 2 * n) / n - 1
    half = 30.0 if kind == "hall" else HALF
    return np.array([(a * half, -HALF), (b * half, HALF)])


def _mesh(
    comm: MPI.Intracomm, kind: str, n: int, seed: int, angle: float, height: float, path: Array
) -> meshes.MembraneMesh:
    """A mesh of a kind."""
    h, corner = WIDTH / n, (-HALF, -HALF)
    if kind in GRIDS:
        return meshes.from_arrays(comm, *_grid(kind, n))
    if kind == "turned":
        points, cells = rotated_lattice(n, angle)
        return meshes.from_arrays(comm, points - HALF, cells)
    if kind == "polar":
        return meshes.from_arrays(comm, *_polar(n // 2, height))
    if kind == "jiggled":
        return meshes.from_arrays(comm, *scenes.mesh(kind, n, seed))
    if kind == "cap":
        return meshes.spherical_cap(comm, HALF, height, h)
    if kind == "hall":
        return meshes.air_hall(comm, 60.0, WIDTH, height, h, corner=(-30.0, -HALF))
    if kind == "embedded":
        return _embedded(comm, h, path)
    finer = [meshes.Refinement(path.tolist(), h / 2, 3 * h)] if kind == "refined" else []
    return meshes.rectangle(comm, WIDTH, WIDTH, h, corner=corner, refinements=finer)


def _grid(kind: str, n: int) -> tuple[Array, npt.NDArray[np.int64]]:
    """Squares cut by a diagonal to the right, the left, in turn (Union Jack), or both."""
    line = np.linspace(-HALF, HALF, n + 1)
    points = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    numbers = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (
        k.ravel() for k in (numbers[:-1, :-1], numbers[1:, :-1], numbers[1:, 1:], numbers[:-1, 1:])
    )
    i, j = (k.ravel() for k in np.indices((n, n)))
    if kind == "crossed":
        middle = len(points) + np.arange(n * n)
        cells = [np.stack(k, -1) for k in ((a, b, middle), (b, c, middle), (c, d, middle),
                                           (d, a, middle))]  # fmt: skip
        points = np.concatenate([points, (points[a] + points[c]) / 2])
        return np.column_stack([points, np.zeros(len(points))]), np.concatenate(cells)
    left = {"right": 0 * i, "left": 0 * i + 1, "union": (i + j) % 2}[kind][:, None] == 1
    first = np.where(left, np.stack([a, b, d], -1), np.stack([a, b, c], -1))
    second = np.where(left, np.stack([b, c, d], -1), np.stack([a, c, d], -1))
    points = np.column_stack([points, np.zeros(len(points))])
    return points, np.concatenate([first, second])


def _polar(rings: int, height: float) -> tuple[Array, npt.NDArray[np.int64]]:
    """A cap whose mesh has meridians, with one along the x axis on both sides."""
    around = 2 * ((3 * rings + 1) // 2)
    R = (HALF**2 + height**2) / (2 * height)
    r = np.arcsin(HALF / R) * np.arange(1, rings + 1) / rings
    t = np.arange(around) * 2 * np.pi / around
    points = [(0.0, 0.0, height)] + [
        (R * np.sin(a) * np.cos(b), R * np.sin(a) * np.sin(b), R * np.cos(a) - R + height)
        for a in r for b in t
    ]  # fmt: skip
    cells = [(0, 1 + k, 1 + (k + 1) % around) for k in range(around)]
    for i in range(rings - 1):
        for k in range(around):
            a, b = 1 + i * around + k, 1 + i * around + (k + 1) % around
            cells += [(a, a + around, b), (b, a + around, b + around)]
    return np.array(points), np.array(cells)


def _embedded(comm: MPI.Intracomm, h: float, path: Array) -> meshes.MembraneMesh:
    """The square with a line in it, by a .geo file."""
    (x, y), (u, v) = path
    corners = [(x, -HALF), (u, -HALF), (u, v), (u, HALF), (x, HALF), (x, y)]
    text = [f"Point({k}) = {{{a:.15g}, {b:.15g}, 0, {h}}};" for k, (a, b) in enumerate(corners, 1)]
    text += [f"Line({k}) = {{{k}, {k % 6 + 1}}};" for k in range(1, 7)]
    text += ["Line(7) = {3, 6};", "Curve Loop(1) = {1, 2, 3, 4, 5, 6};"]
    text += ["Plane Surface(1) = {1};", "Line{7} In Surface{1};"]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(comm.bcast(folder)) / "line.geo"
        if comm.rank == 0:
            file.write_text("\n".join(text), encoding="utf-8")
        return meshes.from_file(comm, file)


def detour(path: Array, aside: float) -> Array:
    """A path in plan that is some way beside another one in between."""
    way = path[-1, :2] - path[0, :2]
    left = np.array([-way[1], way[0]]) / np.linalg.norm(way)
    if path.shape[1] == 3:
        left = np.append(left, 0.0)
    if len(path) == 2:
        share = np.array([0.0, 0.3, 0.7, 1.0])[:, None]
        path, profile = path[0] + share * (path[-1] - path[0]), np.array([0, 1, -0.6, 0])
        path[1:-1, 2:] = 0.0  # on the flat membrane
    else:
        profile = np.sin(2 * np.pi * np.linspace(0, 1, len(path)))
        profile[-1] = 0.0
    path = path + aside * profile[:, None] * left
    path[1:-1, :2] = np.clip(path[1:-1, :2], -0.96 * HALF, 0.96 * HALF)
    return np.asarray(path)


class Ways:
    """Solves a scene in several ways."""

    def __init__(self, given: Setting, comm: MPI.Intracomm = MPI.COMM_WORLD) -> None:
        self.given, self.mesh = given, given.mesh(comm)
        scene, solver = self._membrane()
        solver.advance(pressure=given.pressure)
        laid = [  # the scenes of the README's figures are made of lengths on facets
            scene.lay_cable(Cable(32000.0), path, measured_on="facets") for path in given.paths
        ]
        self.L0 = [c.L0 * (1 - s) for c, s in zip(laid, given.shorter, strict=True)]

    def _membrane(self) -> tuple[Scene, Solver]:
        scene = Scene(self.mesh, IsotropicMembrane(E=300.0, nu=self.given.nu, thickness=0.08))
        scene.fix("boundary")
        return scene, Solver(scene)

    def solve(self, way: str) -> tuple[Scene, Solver]:
        """The scene, brought to its load in a way."""
        given, (scene, solver) = self.given, self._membrane()
        p = given.pressure
        if way == "after":
            solver.advance(pressure=p)
        for layer, (path, L0) in enumerate(zip(given.paths, self.L0, strict=True)):
            route = detour(path, 2.7 * given.h) if way == "detour" else path
            scene.lay_cable(Cable(32000.0), route, L0=L0, layer=layer)
        if way == "beyond":
            solver.advance(pressure=3 * p)
        if way == "out":
            solver.advance(pressure=p)
            for sign in (1, -1):
                x, y, z = (sign * d for d in given.out)
                solver.advance(move={scene.cables[0].start: (x, y, z)})
        solver.advance(pressure=p, steps=5 if way == "steps" else 1)
        return scene, solver


def run(number: int, ways: Sequence[str] = WAYS, n: int | None = None) -> Result:
    """Solve a scene in some ways, and once more each."""
    given, began = setting(number, n), time.process_time()
    result = Result(
        number, given.kind, given.on_lines, given.n, len(given.paths), max(given.shorter)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", errors.PathWarning)
        solving = Ways(given)
        for way in ways:
            state = way
            try:
                with limited(SECONDS):
                    scene, solver = solving.solve(way)
                    W, T = scene.energy, [cable.tension for cable in scene.cables]
                    result.W[way], result.T[way] = W, T
                    result.scale = sum(map(abs, scene.energies.values()))
                    result.evaluations += sum(step.outcome.evaluations for step in solver.steps)
                    S = float(np.max(solver.results().second_piola, initial=0.0))
                    S = scene.comm.allreduce(S, op=MPI.MAX)
                    result.tense = min(result.tense, min(T) / (S * given.h))
                    lifted = [int(cable.state.lifted.sum()) for cable in scene.cables if cable.taut]
                    result.lifted = max(result.lifted, *lifted, 0)
                    state = f"{way}, again"
                    done = solver.advance(pressure=given.pressure)
                result.again_evaluations += done.outcome.evaluations
                result.moved[way] = abs(scene.energy / W - 1.0)
                moved = zip(scene.cables, T, strict=True)
                result.tightened[way] = max(abs(c.tension - t) / max(t, 1e-300) for c, t in moved)
            except (errors.InputError, errors.ConvergenceError, HangError) as error:
                result.refused[state] = kind_of(error)
    result.seconds = time.process_time() - began
    return result


HEAD = (
    f"{'':>5}{'mesh':>16}{'n':>4}{'cables':>7}{'shorter':>9}{'dW/sum':>9}{'dW/W':>9}{'dT/T':>9}"
    f"{'again W':>9}{'T':>9}{'T/Sh':>7}{'off':>4}{'eval.':>7}{'s':>5}"
)


def line(result: Result) -> str:
    """A line of figures."""
    kind = result.kind + (", lines" if result.on_lines else "")
    again = [max(d.values(), default=0.0) for d in (result.moved, result.tightened)]
    figures = "".join(f"{x:9.1e}" for x in (*result.worst, *again))
    off = [way for way in result.W if not result.within(way)]
    off += [f"{way}, again" for way in result.moved if not result.rests(way)]
    texts = "".join(f"\n        {way}: {text}" for way, text in result.refused.items())
    return (
        f"{result.number:5}{kind:>16}{result.n:4}{result.cables:7}{result.shorter:9.1e}{figures}"
        f"{result.tense:7.2f}{result.lifted:4}{result.evaluations:7}{result.seconds:5.0f}"
        f"  {'; '.join(off)}{texts}"
    )


def report(results: Sequence[Result]) -> None:
    """Scenes within the bars, by kind of mesh and of way; what was refused; the worst ones."""
    rows: dict[str, list[Result]] = {}
    for result in results:
        kind = f"{result.kind}, lines" if result.on_lines else result.kind
        rows.setdefault(kind, []).append(result)
    rows = dict(sorted(rows.items()))
    rows["two cables"] = [r for r in results if r.cables == 2]
    rows["slack, nearly"] = [r for r in results if r.cables == 1 and r.tense <= SLACK]
    tense = [r for r in results if r.cables == 1 and r.tense > SLACK]
    rows["one, lifts off"] = [r for r in tense if r.lifted]
    rows["one, touches"] = [r for r in tense if not r.lifted]
    rows["all"] = list(results)
    print(f"\n{'within the bars':16}{'scenes':>7}" + "".join(f"{way:>8}" for way in WAYS)
          + f"{'again':>8}{'all ways':>10}")  # fmt: skip
    for kind, own in rows.items():
        counts = [sum(way in r.W and r.within(way) for r in own) for way in WAYS]
        counts.append(sum(all(map(r.rests, WAYS)) for r in own))
        whole = sum(all(way in r.W and r.within(way) for way in WAYS) for r in own)
        print(f"{kind:16}{len(own):7}" + "".join(f"{c:8}" for c in counts) + f"{whole:10}")
    print(f"{sum(r.evaluations for r in results)} evaluations, "
          f"{sum(r.again_evaluations for r in results)} for the same loads once more, "
          f"{sum(r.seconds for r in results):.0f} s")  # fmt: skip
    print("\nrefused")
    reasons = Counter(text for r in results for text in r.refused.values())
    for text, count in reasons.most_common():
        where = [(r.number, way) for r in results for way, t in r.refused.items() if t == text]
        print(f"{count:6}  {text}   {where[:4]}")
    print("\nworst by W, by T, by the same load once more\n" + HEAD)
    for key in (
        lambda r: r.worst[1], lambda r: r.worst[2], lambda r: max(r.moved.values(), default=0.0),
    ):  # fmt: skip
        for result in sorted(results, key=key)[:-9:-1]:
            print(line(result))
        print()


def main() -> None:
    """Run scenes and print the tables."""
    parser = argparse.ArgumentParser(description="Ways to an equilibrium: see this file's head.")
    parser.add_argument("--scenes", nargs=2, type=int, metavar=("FIRST", "END"), default=(0, 0))
    parser.add_argument("--cells", type=int, help="cells a side, instead of each scene's own")
    parser.add_argument("--to", type=Path, help="file to which a line is added for each scene")
    parser.add_argument("--report", type=Path, nargs="+", default=[], help="files of results")
    given = parser.parse_args()
    root = MPI.COMM_WORLD.rank == 0
    found = [
        Result(**json.loads(text))
        for path in given.report
        for text in path.read_text(encoding="utf-8").splitlines()
    ]
    if root and not found:
        print(HEAD)
    for number in range(*given.scenes):
        found.append(run(number, n=given.cells))
        if root:
            print(line(found[-1]), flush=True)
        if root and given.to is not None:
            with given.to.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(found[-1])) + "\n")
    if root and found:
        report(found)


if __name__ == "__main__":
    main()
