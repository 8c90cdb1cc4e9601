"""Section forces that differ along warp and weft, and the warp given to `find_form`: it is that of
the fabric, also where the section forces are one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced
from form_meshes import cylinder, nodes, order
from grids import grid
from mpi4py import MPI
from scipy.optimize import brentq, minimize_scalar

from crms_fenicsx import InputError, IsotropicMembrane, OrthotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.design.form_finding import FoundForm, find_form

SLOPE = 1e-4


def wave(comm: MPI.Intracomm, size: float, stress: object, warp: object) -> float:
    """Relative height of the middle of a strip between two waves, 6 long and 4 wide."""
    mesh = meshes.rectangle(comm, 6.0, 4.0, size, structured=True)
    form = find_form(
        mesh, stress, fixed=["boundary"], warp=warp,
        lifted={"boundary": lambda x: SLOPE * np.stack([0 * x[0], 0 * x[0],
                np.sin(np.pi * x[0] / 6.0) * (np.abs(x[1] - 2.0) > 1.999)])},
    )  # fmt: skip
    x = nodes(form)
    middle = np.argmin(np.hypot(x[:, 0] - 3.0, x[:, 1] - 2.0))
    return float(x[middle, 2]) / SLOPE


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("stress", "warp", "ratio"),
    [
        ((4.0, 1.0), (1.0, 0.0, 0.0), 4.0),
        ((4.0, 1.0), (0.0, 1.0, 0.3), 0.25),
        (3.0, (1, 1, 1), 1.0),
    ],
)
def test_small_slopes(comm: MPI.Intracomm, stress: object, warp: object, ratio: float) -> None:
    """``s_x z_xx + s_y z_yy = 0``, with second order."""
    exact = 1 / np.cosh(np.pi / 6.0 * np.sqrt(ratio) * 2.0)
    errors = [wave(comm, size, stress, warp) / exact - 1 for size in (1.0, 0.5, 0.25)]
    assert abs(errors[-1]) < 0.01
    assert order((1.0, 0.5, 0.25), errors) > 1.7


def test_forms_that_the_forces_do_not_allow_are_near(comm: MPI.Intracomm) -> None:
    """Along a hypar different forces do not balance; what is missing is small, and told."""
    deviations = []
    for stress in ((2.0, 2.0), (2.2, 2.0), (4.0, 2.0)):
        mesh = meshes.rectangle(comm, 10.0, 10.0, 1.0, structured=True)
        form = find_form(
            mesh, stress, fixed=["boundary"],
            lifted={"boundary": lambda x: np.stack([0 * x[0], 0 * x[0],
                    0.04 * (x[0] - 5.0) * (x[1] - 5.0)])},
        )  # fmt: skip
        deviations.append(form.deviation)
    assert deviations[0] < 1e-3
    assert 0 < deviations[1] < deviations[2] < 0.02


@pytest.mark.parametrize(
    ("stress", "warp", "across"), [((4.0, 2.0), (0, 1, 0), 2.0), ((4.0, 2.0), (1, 0, 0), 4.0)]
)
def test_vaults(
    comm: MPI.Intracomm, stress: tuple[float, float], warp: tuple[int, int, int], across: float
) -> None:
    """Of radius (section force across) / pressure, whatever it is along: they balance exactly.

    The radius of 10, span of 12 and rise of 2 are in the rim, which is on the vault.
    """
    sizes, errors, deviations = (2.0, 1.0, 0.5), [], []
    half = np.arcsin(0.6)

    def arc(x: np.ndarray) -> np.ndarray:
        turn = half * (x[0] / 6.0 - 1.0)
        return np.stack([6.0 + 10.0 * np.sin(turn) - x[0], 0 * x[0], 10.0 * np.cos(turn) - 8.0])

    for size in sizes:
        form = find_form(
            meshes.rectangle(comm, 12.0, 8.0, size, structured=True), stress, fixed=["boundary"],
            lifted={"boundary": arc}, warp=warp, pressure=across / 10.0,
        )  # fmt: skip
        x = nodes(form)
        errors.append(np.abs(np.hypot(x[:, 0] - 6.0, x[:, 2] + 8.0) / 10.0 - 1.0).max())
        deviations.append(form.deviation)
    assert errors[-1] < 4e-5
    assert order(sizes, errors) > 1.8
    assert order(sizes, deviations) > 1.5


def nearest_neck(meridian: float, hoop: float) -> tuple[float, float]:
    """Neck of a surface between rings of R = 10, 8 apart, and its deviation, by a closed form.

    With hoop forces h the meridian's are m = h + C / r, as d(r m) = h dr, and r m is the constant F
    along the axis times the slope ds / dz. So h r + C = F cosh(h z / F), a catenary that is shifted
    by C. Of these surfaces, all in equilibrium, it is the one whose m is nearest to that
    prescribed in the mean square over the surface.
    """
    radius, half = 10.0, 4.0
    z = np.linspace(-half, half, 401)

    def surface(C: float) -> tuple[np.ndarray, np.ndarray]:
        rho, low = hoop * radius + C, hoop * half / 1.1997  # where the cosh has its tangent
        F = brentq(lambda F: F * np.cosh(hoop * half / F) - rho, low, rho)
        return (F * np.cosh(hoop * z / F) - C) / hoop, np.cosh(hoop * z / F)

    def missed(C: float) -> float:
        r, slope = surface(C)
        return float(np.sum((C / r - (meridian - hoop)) ** 2 * r * slope))

    guess = (meridian - hoop) * radius
    C = float(minimize_scalar(missed, bracket=(0.9 * guess, guess)).x)
    r = surface(C)[0]
    return float(r.min()), float(np.abs(C / r - (meridian - hoop)).max()) / max(meridian, hoop)


@pytest.mark.parametrize("stress", [(2.2, 2.0), (4.0, 2.0)])
def test_surfaces_of_revolution(comm: MPI.Intracomm, stress: tuple[float, float]) -> None:
    """Nothing has different constant forces there; what is found is the nearest equilibrium."""
    neck, deviation = nearest_neck(*stress)
    catenoid = brentq(lambda a: a * np.cosh(4.0 / a) - 10.0, 4.0 / 1.1997, 10.0)
    assert neck > catenoid + 0.09
    sizes, errors = np.array([16, 32, 64]), []
    for n in sizes:
        form = find_form(
            cylinder(comm, n, n // 4, 10.0, 8.0), stress, fixed=["boundary"], warp=(0, 0, 1)
        )
        errors.append(np.hypot(*nodes(form)[:, :2].T).min() / neck - 1)
        assert form.deviation < deviation
    assert abs(errors[-1]) < 2.5e-4
    assert form.deviation > 0.7 * deviation
    assert order(1 / sizes, errors) > 1.8


FABRIC = OrthotropicMembrane(E1=900.0, E2=100.0, G12=30.0, nu21=0.0, thickness=1.0)
ACROSS = OrthotropicMembrane(
    E1=900.0, E2=100.0, G12=30.0, nu21=0.0, thickness=1.0, warp=(0.0, 1.0, 0.0)
)
Y, X = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)


def flat(comm: MPI.Intracomm, stress: object = 2.0, **options: object) -> FoundForm:
    mesh = meshes.rectangle(comm, 6.0, 4.0, 1.0, structured=True)
    return find_form(mesh, stress, fixed=["boundary"], **options)  # type: ignore[arg-type]


def halves(comm: MPI.Intracomm, stress: Mapping[str, object], warp: object) -> FoundForm:
    """A strip of two parts."""
    x, cells = grid(np.arange(7.0), np.arange(5.0), by_rows=True)
    left = x[cells][:, :, 0].max(axis=1) <= 3.0
    mesh = meshes.from_arrays(
        comm, x, cells, parts={"left": np.flatnonzero(left), "right": np.flatnonzero(~left)}
    )
    return find_form(mesh, stress, fixed=["boundary"], warp=warp)  # type: ignore[arg-type]


def warps(scene: Scene) -> dict[str, object]:
    """By part."""
    names, own = scene.membrane.parts, scene.membrane.materials
    return {names.get(k, ""): material.warp for k, material in own.items()}


@pytest.mark.parametrize("stress", [2.0, (2.0, 2.0), (2.0, 1.9)])
def test_sag_does_not_depend_on_how_the_force_is_written(
    comm: MPI.Intracomm, stress: object
) -> None:
    """Across a span of 4 the strong warp carries the snow: so does a scene without a form."""
    solvers = []
    for scene in (
        flat(comm, stress, warp=Y).scene(FABRIC),
        flat(comm, 2.0).scene(ACROSS),
        flat(comm, 2.0, warp=(0.0, -3.0, 0.0)).scene(ACROSS),
    ):
        scene.put_load((0.0, 0.0, -1.0), name="snow", per="plan")
        solver = advanced(Solver(scene), load=1.0)
        solvers.append(float(solver.results().at([(3.0, 2.0)])["warp"][0]))
    assert solvers[1] == pytest.approx(solvers[2], rel=1e-9)
    assert solvers[0] == pytest.approx(solvers[1], rel=0.02 if stress == (2.0, 1.9) else 1e-9)


def test_which_warp_counts(comm: MPI.Intracomm) -> None:
    """The form's where one is given or matters, else the material's."""
    assert warps(flat(comm).scene(ACROSS)) == {"": Y}
    assert warps(flat(comm).scene(FABRIC)) == {"": X}
    assert warps(flat(comm, warp=Y).scene(FABRIC)) == {"": Y}
    assert warps(flat(comm, (2.0, 1.9)).scene(FABRIC)) == {"": X}
    foil = IsotropicMembrane(E=500.0, nu=0.3, thickness=1.0)
    assert warps(flat(comm, warp=Y).scene(foil)) == {"": None}
    parts = {"right": 2.0, "left": (2.0, 2.0)}
    form = halves(comm, parts, {"left": Y, "right": (1.0, 1.0, 0.0)})
    assert warps(form.scene(FABRIC)) == {"left": Y, "right": (1.0, 1.0, 0.0)}
    assert warps(form.scene({"left": FABRIC, "right": foil})) == {"left": Y, "right": None}
    mixed = halves(comm, parts, {"left": Y, "right": None})
    assert warps(mixed.scene({"left": FABRIC, "right": FABRIC})) == {"left": Y, "right": X}


@pytest.mark.ranks
def test_warps_of_parts_in_another_order(comm: MPI.Intracomm) -> None:
    """Each part has its own, whatever the order of the keys."""
    stress = {"left": (2.0, 1.0), "right": (1.0, 2.0)}
    forms = [
        halves(comm, stress, dict(order))
        for order in ((("left", X), ("right", Y)), (("right", Y), ("left", X)))
    ]
    for form in forms:  # 2 along x in both, as a plane has it
        assert form.deviation < 1e-9
    np.testing.assert_array_equal(forms[0].stress.directions, forms[1].stress.directions)


@pytest.mark.parametrize(
    ("options", "material"),
    [
        ({"warp": Y}, {"warp": (1.0, 1.0, 0.0)}),
        ({"warp": Y}, {"warp": lambda x: np.tile([[0.0], [1.0], [0.0]], x.shape[1])}),
        ({"stress": (2.0, 1.0)}, {"warp": Y}),
        ({"warp": X}, {"warp": Y}),
    ],
)
def test_two_warps_are_refused(
    comm: MPI.Intracomm, options: dict[str, object], material: dict[str, object]
) -> None:
    own = OrthotropicMembrane(900.0, 100.0, 30.0, 0.0, 1.0, **material)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"has the warp .* but the form \(.*pass it to find_form"):
        flat(comm, **options).scene(own)  # type: ignore[arg-type]


def test_resume_with_the_warp_of_a_form(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """A checkpoint of one warp is not that of another."""
    folder, sags = Path(comm.bcast(str(tmp_path))), []
    for resume in (False, True):
        scene = flat(comm, warp=Y).scene(FABRIC)
        scene.put_load((0.0, 0.0, -1.0), name="snow", per="plan")
        solver = Solver(scene, results=folder / "out", resume=resume)
        solver.advance(load=1.0)
        sags.append(scene.u.x.array.copy())
    assert np.array_equal(*sags)
    solver.save(folder / "state")
    with pytest.raises(InputError):
        Solver(flat(comm, warp=X).scene(FABRIC)).load(folder / "state")
