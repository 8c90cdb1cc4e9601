"""The potential of sealed air: Taylor tests, its gas law, and H0's dyad."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from octant import octant
from scipy.integrate import quad
from taylor import gradient_order, stiffness_error, stiffness_order
from term_scene import cable_square, directions, displaced

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.energy.minimization.taylor import TermsWithDyads
from crms_fenicsx.energy.terms.sealed_pressure import SealedPressure
from crms_fenicsx.model.sealed_air import LEAST, SealedAir


@pytest.mark.ranks
@pytest.mark.parametrize("exponent", [1.0, 1.4])
def test_taylor_with_folded_cells(comm: MPI.Intracomm, exponent: float) -> None:
    """All parts of the volume count, and the dyad is what a given pressure's Hessian lacks."""
    scene = cable_square(comm).scene
    scene.seal(volume=5e4, atmosphere=0.3, exponent=exponent)
    system = System(scene, "crms_test_", 1e-8)
    system.read_scene()
    term = system.pressure.sealed
    assert isinstance(term, SealedPressure)
    assert [type(part).__name__ for part in term.parts] == [
        "FollowerPressure", "FoldedFollowerPressure",
    ]  # fmt: skip
    f = TermsWithDyads(system.unknowns, scene.u, [term], exact=True)
    x = displaced(f.unknowns, 1.5, stretch=1.02)
    x[:, 2] += 2.0  # far from the volume at sealing
    for d in directions(f.unknowns).values():
        assert gradient_order(f, x, d) == pytest.approx(2, abs=0.05)
        assert stiffness_order(f, x, d) > 2.9
        assert stiffness_error(f, x, d, h=1e-5) < 2e-6


@pytest.mark.ranks
def test_taylor_where_the_rim_slides(comm: MPI.Intracomm) -> None:
    scene = octant(comm, 3)
    scene.seal(volume=65.0)
    system = System(scene, "crms_test_", 1e-8)
    system.read_scene()
    term = system.pressure.sealed
    assert isinstance(term, SealedPressure)
    assert len(term.parts) == 2
    f = TermsWithDyads(system.unknowns, scene.u, [term], exact=True)
    n = f.unknowns.n_owned
    x = 0.05 * f.unknowns.X[:n] * (1 + f.unknowns.X[:n, ::-1])
    d = f.unknowns.X[:n, [1, 2, 0]] ** 2
    for values in (x, d):
        values[f.unknowns.held[:n]] = 0.0
    assert gradient_order(f, x, d, 0.1 * 0.25 ** np.arange(6)) == pytest.approx(2, abs=0.05)


@pytest.mark.parametrize("exponent", [1.0, 1.1, 1.4])
def test_gas_law(exponent: float) -> None:
    """Energy by a quadrature of the pressure, from a hundred-thousandth of a change to the edge."""
    air = SealedAir(20.0, 3.0, 0.7, 102.0, exponent, 96.3, 1.1)
    for v in (1e-5, -1e-5, 0.0999, 0.1001, -0.0999, -0.1001, 4.0, -0.9, LEAST - 1.02):
        gained = 3.0 + 20.0 * v
        if v > LEAST - 1:
            p = 1.1 * 102.0 * (1 + v) ** -exponent - 96.3
            assert air.pressure(gained) == pytest.approx(p, rel=1e-12)
            kink = None
        else:
            kink = [3.0 + 20.0 * (LEAST - 1)]
        work = quad(air.pressure, 3.0, gained, epsabs=0, epsrel=1e-12, points=kink)[0]
        assert air.energy(gained) + 0.7 * 3.0 == pytest.approx(-work, rel=1e-10)
        slope = (air.pressure(gained + 1e-4) - air.pressure(gained - 1e-4)) / 2e-4
        assert air.stiffness(gained) == pytest.approx(-slope, rel=1e-5)
    assert air.energy(3.0) == -0.7 * 3.0


def test_small_changes_are_not_lost() -> None:
    """As much of the energy's second-order part is right as of the change of volume itself."""
    air = SealedAir(1.0, 0.0, 0.0, 101.325, 1.4, 101.325)
    for v in (1e-3, 1e-6, 1e-9):
        expected = 101.325 * 1.4 * v**2 / 2 * (1 - 2.4 * v / 3 + 2.4 * 3.4 * v**2 / 12)
        assert air.energy(v) == pytest.approx(expected, rel=1e-9)
