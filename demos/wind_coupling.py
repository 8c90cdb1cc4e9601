"""Coupling with a wind model
==========================

An inflated roof in a wind tunnel, coupled with a flow model in plain DOLFINx.

The air streams between the roof and the tunnel's ceiling. Where the roof rises, the gap narrows,
the air accelerates, and by Bernoulli's law its suction grows: the roof rises further. The programs
are independent, each with its own mesh: the flow takes heights and returns pressures, the membrane
takes forces and returns displacements. Iterations with Aitken's relaxation continue until both
agree. Each starts from the same *snapshot*, because friction of the cable depends on the path.
`preCICE <https://precice.org>`_ couples programs in this way. Units: m, kN, s.

::

    ./run python demos/wind_coupling.py
"""

import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.fem import petsc
from dolfinx.mesh import create_rectangle, locate_entities_boundary
from mpi4py import MPI
from petsc4py import PETSc
from scipy.interpolate import LinearNDInterpolator

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.results.output import draw

RESULTS = "results/wind_coupling"
SIDE, CEILING, BESIDE, BEFORE = 20.0, 3.0, 5.0, 10.0
"""Side of the roof, height of the tunnel; tunnel width beside, length before and behind."""
DENSITY, SPEED = 1.25e-3, 25.0  # air density (t/m3) and inflow velocity (m/s)
comm = MPI.COMM_WORLD


def everywhere(values):
    """Values of all ranks, concatenated: both meshes are small."""
    return np.concatenate(comm.allgather(values))


# %%
# The wind
# --------
# The gap is shallow, so the velocity is constant over its height h and has a potential in plan:
# ``div(h grad phi) = 0``. Bernoulli's law gives the pressure relative to the incoming air.
class Wind:
    """Potential flow through a gap of given height."""

    def __init__(self, size):
        low, high = (-BEFORE, -BESIDE), (SIDE + BEFORE, SIDE + BESIDE)
        cells = [round((b - a) / size) for a, b in zip(low, high, strict=True)]
        mesh = create_rectangle(comm, (low, high), cells)
        V = fem.functionspace(mesh, ("Lagrange", 1))
        phi, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        self.h, self.phi, self.suction, self.area = (fem.Function(V) for _ in range(4))
        end = locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[0], SIDE + BEFORE))
        self.bc = fem.dirichletbc(0.0, fem.locate_dofs_topological(V, 1, end), V)
        enters = ufl.conditional(ufl.lt(ufl.SpatialCoordinate(mesh)[0], -BEFORE + 1e-6), 1.0, 0.0)
        self.flow = fem.form(self.h * ufl.inner(ufl.grad(phi), ufl.grad(v)) * ufl.dx)
        self.inflow = fem.form(-SPEED * CEILING * enters * v * ufl.ds)
        speed = ufl.inner(ufl.grad(self.phi), ufl.grad(self.phi))
        self.works = fem.form(DENSITY / 2 * (SPEED**2 - speed) * v * ufl.dx)
        self.areas = fem.form(v * ufl.dx)
        self.flux = fem.form(self.h * self.phi.dx(0) / (SIDE + 2 * BEFORE) * ufl.dx)
        self.places = V.tabulate_dof_coordinates()[:, :2]

    def answer(self, points, heights):
        """Pressure at points in plan (n, 2) of a roof with vertex heights (m,)."""
        roof = LinearNDInterpolator(*heights, fill_value=0.0)
        self.h.x.array[:] = CEILING - roof(self.places)
        A, b = petsc.assemble_matrix(self.flow, [self.bc]), petsc.assemble_vector(self.inflow)
        A.assemble()
        b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        petsc.set_bc(b, [self.bc])
        ksp = PETSc.KSP().create(comm)
        ksp.setOperators(A)
        ksp.setType(PETSc.KSP.Type.CG)
        ksp.setTolerances(rtol=1e-12)
        ksp.solve(b, self.phi.x.petsc_vec)
        self.phi.x.scatter_forward()
        for one in (A, b, ksp):
            one.destroy()
        for function, form in ((self.suction, self.works), (self.area, self.areas)):
            function.x.array[:] = 0.0
            fem.assemble_vector(function.x.array, form)
            function.x.scatter_reverse(la.InsertMode.add)
        own = slice(0, self.phi.function_space.dofmap.index_map.size_local)
        values = self.suction.x.array[own] / self.area.x.array[own]
        return LinearNDInterpolator(everywhere(self.places[own]), everywhere(values))(points)


# %%
# The roof
# --------
# An inflated sheet, and a cable with friction across it.
mesh = meshes.rectangle(comm, SIDE, SIDE, 2.0, structured=True)
scene = Scene(mesh, IsotropicMembrane(E=600.0, nu=0.3, thickness=1.0))
scene.fix("boundary")
solver = Solver(scene)
solver.advance(pressure=0.3, steps=2)
cable = scene.lay_cable(Cable(EA=5e3, friction=0.3), [(9.3, 0.0), (11.2, SIDE)], name="ridge")
solver.advance()

# %%
# A DOLFINx form turns the wind pressure into nodal forces along the normals of the current surface.
# The wind in turn needs the heights of the roof.
p = fem.Function(fem.functionspace(mesh.mesh, ("Lagrange", 1)))
forces = fem.Function(scene.V)
J = ufl.Jacobian(mesh.mesh)
a, b = (J[:, k] + ufl.dot(ufl.grad(scene.u), J[:, k]) for k in (0, 1))
flat = ufl.cross(J[:, 0], J[:, 1])
inward = -ufl.cross(a, b) / ufl.sqrt(ufl.dot(flat, flat))
push = fem.form(p * ufl.inner(inward, ufl.TestFunction(scene.V)) * ufl.dx)
n = scene.V.dofmap.index_map.size_local


def blow(pressure):
    """Solve for the roof under pressures at its vertices, from `calm`."""
    p.x.array[:] = pressure
    forces.x.array[:] = 0.0
    fem.assemble_vector(forces.x.array, push)
    forces.x.scatter_reverse(la.InsertMode.add)
    solver.restore(calm)
    scene.put_forces(forces, name="wind")
    solver.advance(load={"wind": 1.0})


def answer():
    """Wind pressure at the roof's vertices."""
    at = scene.positions()
    shape = everywhere(at[:n, :2]), everywhere(at[:n, 2])
    return wind.answer(at[:, :2], shape)


# %%
# Together
# --------
# The pressure on the roof must equal the pressure that the wind returns. Aitken's relaxation uses
# the fraction of the difference that would have been right in the previous iteration.
calm, wind = solver.snapshot(), Wind(1.0)


def dot(x, y):
    """Scalar product of vertex values, each counted on its owner."""
    return comm.allreduce(float(x[:n] @ y[:n]))


crowns = [everywhere(scene.positions()[:n, 2]).max()]
pressure, part, before = answer(), 1.0, None
for iteration in range(1, 21):
    blow(pressure)
    crowns.append(everywhere(scene.positions()[:n, 2]).max())
    rest = answer() - pressure
    error = np.sqrt(dot(rest, rest) / dot(pressure, pressure))
    if comm.rank == 0:
        print(f"iteration {iteration}  crown {crowns[-1]:.5f} m  difference {error:.1e}")
    if error < 1e-6:
        break
    if before is not None:
        part *= -dot(before, rest - before) / dot(rest - before, rest - before)
    pressure, before = pressure + part * rest, rest

# %%
# The result
# ----------
# The wind pressure on the undeformed roof, as in the first iteration, gives too small a rise. The
# flow conserves mass.
flux = comm.allreduce(fem.assemble_scalar(wind.flux))
enters = SPEED * CEILING * (SIDE + 2 * BESIDE)
lift = comm.allreduce(forces.x.array[: 3 * n].reshape(-1, 3).sum(axis=0))[2]
more = (crowns[-1] - crowns[0]) / (crowns[1] - crowns[0]) - 1.0
draw(solver, f"{RESULTS}/roof.png", unit="m", force="kN")
if comm.rank == 0:
    print(f"the crown rises from {crowns[0]:.3f} m to {crowns[-1]:.3f} m, by {more:.0%} more than")
    print(f"by the wind over the calm roof; lift {lift:.1f} kN, tension {cable.tension:.2f} kN")
    print(f"of {enters:.1f} m3/s of air that enter {flux:.1f} m3/s pass")
    print(f"files: {RESULTS}")
