"""The warp given to `find_form` is that of the fabric, also where the section forces are one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from crms_fenicsx import InputError, IsotropicMembrane, OrthotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.design.form_finding import FoundForm, find_form

pytestmark = pytest.mark.usefixtures("comm")
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
    x = np.stack(np.meshgrid(np.arange(7.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    a = (7 * np.arange(4)[:, None] + np.arange(6)).ravel()
    cells = np.stack([np.stack([a, a + 1, a + 8], 1), np.stack([a, a + 8, a + 7], 1)], 1)
    cells = cells.reshape(-1, 3)
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
        solver = Solver(scene)
        solver.advance(load=1.0)
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
