"""Sweeps over loads: pressure, prestress, deflation to a floor, snow on a dome."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import cache

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.foundation.meshes.triangles import area_vectors
from sweeps.judge import Judge, Point
from sweeps.scenes import COMM, FOIL, MODULUS, PRESSURE, SIDE, across, clamped, heights, square, top

UNIT = MODULUS / SIDE
"""The pressure E t / L."""


@cache
def inflated(share: float, steps: int = 1, n: int = 8, prestress: float = 0.0) -> Solver:
    """The square under a share of E t / L, with a share of E t as prestress."""
    material = IsotropicMembrane(300.0, 0.25, 0.08, prestress=prestress * MODULUS)
    solver = Solver(clamped(square(n), material))
    solver.advance(pressure=share * UNIT, steps=steps)
    return solver


def pressure() -> Iterator[Point]:
    """From nothing to strains far beyond 1: St. Venant's law stiffens, and nothing bursts.

    Wrong is what depends on the number of steps; where dW/dp differs from -V; and for small
    pressures heights other than in proportion to its cubic root, up to the order of the strains.
    """

    def run(judge: Judge, share: float, steps: int) -> None:
        solver = inflated(share, steps)
        scene = solver.scene
        judge.solved(solver, anew=False, lying=False, stable=steps == 1)
        if share < 0.1:
            limit = top(inflated(1e-5).scene) / 1e-5 ** (1 / 3)
            allowed = 2 * (share ** (2 / 3) + 1e-5 ** (2 / 3))
            judge.same("w / p^(1/3)", top(scene) / share ** (1 / 3), limit, allowed)
        if steps > 1:
            once = inflated(share).scene
            judge.same("energy in one step", scene.energy, once.energy, 1e-8)
            judge.same("volume in one step", scene.volume, once.volume, 1e-7)
            return
        small = 1e-3
        energies, p, V = [], scene.pressure, scene.volume
        for factor in (1 + small, 1 - small):
            solver.advance(pressure=factor * p)
            energies.append(scene.energy)
        judge.same("-dW/dp and V", (energies[1] - energies[0]) / (2 * small * p), V, 10 * small**2)
        solver.advance(pressure=p)
        judge.same("volume after a detour", scene.volume, V, 1e-7)
        inflated.cache_clear()

    shares = (1e-8, 1e-6, 1e-4, 1e-2, 1 / 24, 0.3, 1.0, 3.0, 10.0, 100.0)
    for share in shares:
        for steps in (1, 2, 5, 20):
            quick = share in (1e-8, 10.0) and steps < 3
            yield Point(
                f"p L / E t = {share:.3g}, {steps} steps",
                lambda judge, share=share, steps=steps: run(judge, share, steps),
                quick=quick,
            )


def prestress() -> Iterator[Point]:
    """From nothing to the modulus, under a small and a usual pressure.

    Wrong is an energy that differs from that of the linear membrane on the same mesh, by more than
    the strain's share; and one that does not rise with the prestress.
    """

    def linear(p: float, stress: float, n: int = 8) -> float:
        """Energy of a membrane with this stress under a small pressure, by linear elements."""
        scene = Scene(square(n), FOIL)
        X = scene.V.tabulate_dof_coordinates()[:, :2]
        cells = scene.V.dofmap.list
        areas = np.linalg.norm(area_vectors(scene.mesh.mesh), axis=1)
        opposite = X[np.roll(cells, -2, axis=1)] - X[np.roll(cells, -1, axis=1)]
        local = np.einsum("cia,cja->cij", opposite, opposite) / (4 * areas[:, None, None])
        rows, columns = np.repeat(cells, 3, axis=1).ravel(), np.tile(cells, 3).ravel()
        K = coo_matrix((local.ravel(), (rows, columns))).tocsc()
        f = np.zeros(len(X))
        np.add.at(f, cells, p * areas[:, None] / 3)
        free = np.flatnonzero(np.all((X > 1e-9) & (X < SIDE - 1e-9), axis=1))
        w = spsolve(K[free][:, free], f[free]) / stress
        return -0.5 * float(f[free] @ w)

    def small(judge: Judge, share: float) -> None:
        load = 1e-2 * share**1.5
        solver = inflated(load, prestress=share)
        judge.solved(solver, lying=False, stable=True)
        exact = linear(load * UNIT, share * MODULUS)
        judge.same("linear membrane", solver.scene.energy, exact, 1e-5)

    def usual(judge: Judge, share: float, softer: float) -> None:
        solver = inflated(1 / 24, prestress=share)
        judge.solved(solver, lying=False, stable=True)
        before = inflated(1 / 24, prestress=softer).scene
        judge.must("energy falls with prestress", solver.scene.energy > before.energy)
        if share < 1e-3:
            none = inflated(1 / 24).scene
            # dW/dS is the elongation of the area, a few per cent.
            judge.same("as without", solver.scene.energy, none.energy, 30 * share + 1e-10)

    shares = (0.0, 1e-8, 1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
    for softer, share in itertools.pairwise(shares):
        yield Point(
            f"S / E t = {share:g}, small pressure",
            lambda judge, share=share: small(judge, share),
            quick=share in (1e-4, 1.0),
        )
        yield Point(
            f"S / E t = {share:g}, p L / E t = 1/24",
            lambda judge, share=share, softer=softer: usual(judge, share, softer),
            quick=share == 1e-8,
        )


def deflation() -> Iterator[Point]:
    """Down to a floor and up again, five times, heavy and with a cable.

    Wrong is an inflated state that is not the first one, what lies below the floor, and a floor
    that does not carry what is missing in the balance.
    """

    def run(judge: Judge, floor: float, low: float, weight: float, cabled: bool) -> None:
        scene = clamped(square(10))
        scene.floor(floor)
        if weight:
            scene.put_load((0.0, 0.0, -weight))
        if cabled:
            scene.lay_cable(Cable(32000.0), across(43.0), L0=100.5)
        solver = Solver(scene)
        load = 1.0 if weight else None
        solver.advance(pressure=PRESSURE, load=load)
        W, z = scene.energy, heights(scene)
        down = []
        for _ in range(5):
            solver.advance(pressure=low * PRESSURE, steps=3)
            judge.sound(solver, anew=False, lying=False)
            down.append(scene.energy)
            solver.advance(pressure=PRESSURE, steps=2)
            judge.same("energy up again", scene.energy, W, 1e-8)
            judge.drift("height up again", np.abs(heights(scene) - z).max() / z.max(), 1e-6)
        judge.solved(solver, lying=False)
        judge.drift("energy down / up", (max(down) - min(down)) / abs(W), 1e-8)

    for floor, low, weight, cabled in (
        (-2.0, 0.0, 1e-3, False), (-2.0, -0.5, 0.0, False), (-2.0, -1.0, 1e-3, False),
        (0.0, -0.5, 0.0, False), (0.0, 0.0, 1e-3, False), (-1e-6, -0.5, 0.0, False),
        (-2.0, -0.5, 0.0, True), (-2.0, 0.0, 1e-3, True), (0.0, -0.5, 0.0, True),
    ):  # fmt: skip
        what = f"floor at {floor:g}, to {low:g} p"
        yield Point(
            what + (", heavy" if weight else "") + (", with a cable" if cabled else ""),
            lambda judge, a=(floor, low, weight, cabled): run(judge, *a),
            quick=floor == -2.0 and low == 0.0 and not cabled,
        )


def dome(height: float, *, wrinkling: bool = True) -> Scene:
    """An air dome of 40 m span."""
    mesh = meshes.spherical_cap(COMM, radius=20.0, height=height, size=5.0)
    return clamped(mesh, IsotropicMembrane(800e3, 0.3, 1e-3, wrinkling=wrinkling))


def snow() -> Iterator[Point]:
    """Snow on a dome, beyond what its pressure carries, and away again.

    Wrong is a state that is a saddle, and another one than the first without snow. Under snow
    several states may be stable: their energies may differ, and are compared where they do not.
    """

    def patch(x: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """On the middle, on a plan of 10 m radius, a little to one side."""
        on = np.hypot(x[0] - 1.0, x[1] - 0.5) < 10.0
        return np.array([0.0, 0.0, -0.4])[:, None] * (on * normals[2])

    def blown(judge: Judge, factor: float, steps: int) -> None:
        scene = dome(10.0)
        solver = Solver(scene)
        solver.advance(pressure=0.4)
        scene.put_load(patch)
        W, z = scene.energy, heights(scene)
        solver.advance(load=factor, steps=steps)
        judge.sound(solver, anew=False, lying=False, stable=True)
        solver.advance(load=0.0, steps=steps)
        judge.solved(solver, lying=False, stable=True)
        judge.same("energy without snow", scene.energy, W, 1e-8)
        judge.drift("heights without snow", np.abs(heights(scene) - z).max() / z.max(), 1e-6)

    def shallow(judge: Judge, factor: float, steps: int) -> None:
        """A cap that resists compression, without pressure: it snaps through to its image."""
        scene = dome(2.0, wrinkling=False)
        scene.put_load((0.0, 0.0, -1.0))
        solver = Solver(scene)
        solver.advance(load=factor, steps=steps)
        judge.sound(solver, anew=False, lying=False, stable=True)
        judge.must("snow does not do work", scene.energies["dead load"] < 0.0)
        solver.advance(load=0.0, steps=steps)
        judge.solved(solver, lying=False, stable=True)
        # Either of the two unstrained shapes, or a dent between them, which costs energy.
        judge.must("energy below nothing", scene.energy > -1e-9)

    for factor in (0.5, 0.9, 1.1, 1.5, 2.0, 5.0, 20.0):
        for steps in (1, 5, 20):
            yield Point(
                f"blown up, snow {factor:g} p, {steps} steps",
                lambda judge, a=(factor, steps): blown(judge, *a),
                quick=factor == 2.0 and steps == 5,
            )
    for factor in (0.01, 0.1, 1.0, 10.0, 100.0):
        for steps in (1, 10):
            yield Point(
                f"shallow and stiff, snow {factor:g}, {steps} steps",
                lambda judge, a=(factor, steps): shallow(judge, *a),
                solvable=False,
            )
