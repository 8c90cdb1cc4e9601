"""The membrane of a scene with the loads that lie on it or blow over it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx.model.changed_materials import checked_materials
from crms_fenicsx.model.materials import MembraneMaterial, Strengths, checked_strengths
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.membrane_load import (
    Area,
    Coefficient,
    MembraneLoad,
    Traction,
    fixed_direction_load,
    nodal_load,
    wind_load,
)
from crms_fenicsx.model.versions import StateWarning, Versions, changes_model
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import InputError, collective
from crms_fenicsx.runtime.readonly import ReadOnly

ANOTHER = "make another Scene(...)"
"""What to do instead of assigning what a scene is made of."""

AIR = ("pressure", "temperature", "atmosphere")
"""What combinations know what is of the air by, as `Solver.advance` does; no names of loads."""


class LoadedMembrane:
    """A membrane and the loads that have been put on it, each with a name and a factor.

    Parameters
    ----------
    membrane
        The membrane.
    """

    comm: ReadOnly[MPI.Intracomm] = ReadOnly("membrane.comm", ANOTHER)
    loads: ReadOnly[tuple[MembraneLoad, ...]] = ReadOnly(
        "_loads", "call scene.put_load(...), scene.put_wind(...) or solver.advance(load=...)"
    )
    """The loads that have been put on the membrane, with their current factors."""
    warnings: ReadOnly[tuple[StateWarning, ...]] = ReadOnly("_warnings", "call solver.advance(...)")
    """What load steps have warned of in the current state; snap-throughs stay until it is left for
    one before."""

    def __init__(self, membrane: Membrane) -> None:
        self.membrane = membrane
        self._loads: tuple[MembraneLoad, ...] = ()
        self.versions = Versions()
        """Internal: numbers of the model and the state, and which of them is an equilibrium."""
        self._warnings: tuple[StateWarning, ...] = ()

    @collective
    def put_load(self, force: Traction, *, name: str = "load", per: Area = "surface") -> None:
        """Put a load of fixed direction on the membrane.

        Its forces follow from the current shape, and then keep direction and size;
        `Solver.advance` multiplies them by its factor.

        Parameters
        ----------
        force
            Force per area (force / length squared): (3,), or a function of points (3, n) on the
            current surface and of its unit normals (3, n), which point to the side that pressure
            pushes to, that returns (3, n).
        name
            What load steps and results know the load by.
        per
            The area that the force is counted by: "surface", that of the current surface; "plan",
            that of its projection along z, as for snow; "material", that of the stress-free
            membrane, as for its weight.

        Raises
        ------
        InputError
            On all ranks: a force that is not finite or of another shape, an area that is not
            known, or a name that is taken.

        Examples
        --------
        >>> scene.put_load((0.0, 0.0, -0.6), name="snow", per="plan")
        >>> scene.put_load((0.0, 0.0, -0.01), name="weight", per="material")
        >>> solver.advance(load={"snow": 1.5, "weight": 1.35})
        """
        checks.same(self.comm, "put_load", force=force, name=name, per=per)
        self._check_new_load("put_load", name)
        self.add_load(fixed_direction_load(self.membrane, force, name, per))

    @collective
    def put_wind(self, pressure: float, coefficient: Coefficient, *, name: str = "wind") -> None:
        """Put wind on the membrane; `Solver.advance` brings it on by its factor.

        Its pressure stays normal to the surface: a load step is solved until the wind's forces are
        those of the shape that it leads to. Coefficients belong to the cells, wherever these move.

        Parameters
        ----------
        pressure
            Peak velocity pressure q_p (force per area), positive.
        coefficient
            Pressure coefficient c_p, positive where the wind presses on the outside and negative
            where it sucks, as in EN 1991-1-4: one number, one of each part of the mesh by its
            name, or a function of points (3, n) on the current surface and of its unit normals
            (3, n) to the outside that returns (n,).
        name
            What load steps and results know the load by.

        Raises
        ------
        InputError
            On all ranks: a pressure that is not positive, coefficients that are not finite or of
            another shape, a part that does not exist or is missing, parts with common cells, or a
            name that is taken.

        Examples
        --------
        >>> scene.put_wind(0.8, {"roof": -0.9, "walls": 0.7}, name="wind along x")
        >>> solver.advance(load={"wind along x": 1.5})
        """
        checks.same(self.comm, "put_wind", pressure=pressure, coefficient=coefficient, name=name)
        self._check_new_load("put_wind", name)
        self.add_load(wind_load(self.membrane, pressure, coefficient, name))

    @collective
    def put_forces(self, forces: fem.Function, *, name: str = "forces") -> None:
        """Put forces on the membrane's vertices, as from another program. Collective.

        They keep direction and size, and are copied: later changes of the function are not seen.

        Parameters
        ----------
        forces
            The force on each vertex (force), a function ``dolfinx.fem.Function(scene.V)``; values
            of ghosts do not count.
        name
            What load steps and results know the load by.

        Raises
        ------
        InputError
            On all ranks: it is no function in the space `V`, a force is not finite, or the name is
            taken.

        Examples
        --------
        >>> forces = dolfinx.fem.Function(scene.V)
        >>> forces.x.array[:] = fluid_forces
        >>> scene.put_forces(forces, name="fluid")
        >>> solver.advance(load={"fluid": 1.0})
        """
        checks.same(self.comm, "put_forces", name=name)
        self._check_new_load("put_forces", name)
        self.add_load(nodal_load(self.membrane, forces, name))

    @collective
    @changes_model
    def set_material(self, material: MembraneMaterial | Mapping[str, MembraneMaterial]) -> None:
        """Give the membrane's materials other numbers, for studies of parameters. Collective.

        The next load step goes to the equilibrium with them. No form is compiled anew.

        Parameters
        ----------
        material
            One for all, or some of those that `Scene` was given, by their parts. Each is of the
            same class as before, with the same warp and wrinkling.

        Raises
        ------
        InputError
            On all ranks: a part that does not exist, a material that differs by more than numbers,
            or a scene with the paper's step-wise strain, whose stresses are those of the steps.

        Examples
        --------
        >>> for E in (300.0, 450.0, 600.0):
        ...     scene.set_material({"roof": IsotropicMembrane(E=E, nu=0.3, thickness=1.0)})
        ...     solver.advance()
        """
        checks.same(self.comm, "set_material", material=material)
        self._check_strain_law()
        self.membrane.materials.update(checked_materials(self.membrane, material))

    @abstractmethod
    def _check_strain_law(self) -> None:
        """Refuse to change materials under a law that knows of the steps before."""

    @collective
    def set_strengths(self, strengths: Strengths | Mapping[str, Strengths]) -> None:
        """Give the fabric's strengths, for the utilisation in results, files and reports.

        They replace those given before. They change no equilibrium and are no part of checkpoints.

        Parameters
        ----------
        strengths
            In warp and weft, divided by the partial factors (force per length): one pair, or one
            of each part by its name. Parts that are not named have no utilisation.

        Raises
        ------
        InputError
            On all ranks: a part that does not exist, parts with common cells, or strengths that are
            not positive.

        Examples
        --------
        >>> scene.set_strengths({"roof": (84.0, 80.0), "wall": (60.0, 57.0)})
        """
        checks.same(self.comm, "set_strengths", strengths=strengths)
        if isinstance(strengths, Mapping):
            strengths = checks.in_one_order(self.comm, strengths)
        found = checked_strengths("set_strengths", strengths, self.membrane.mesh)
        self.membrane.strengths = found

    def in_equilibrium(self) -> bool:
        """Internal: whether nothing has changed since the last load step. Collective."""
        settled = self.versions.are_settled(self.membrane.owned_u)
        return bool(self.comm.allreduce(settled, op=MPI.LAND))

    def require_equilibrium(self, call: str) -> None:
        """Internal: refuse a state that is not the one that the last load step found. Collective.

        Raises
        ------
        InputError
            On all ranks: it is not, or there has been no load step.
        """
        if not self.in_equilibrium():
            raise InputError(f"{call}: {self.versions.trouble}; call solver.advance() before.")

    def _check_new_load(self, call: str, name: str) -> None:
        self.membrane.check_finite(call)
        if not isinstance(name, str) or not name:
            raise InputError(f"{call}: name = {name!r} is no text; give one, as in 'snow'.")
        if name in AIR:
            raise InputError(
                f"{call}: name = {name!r} is one of the air's; give another one, as in 'snow'."
            )
        if name in self.factors:
            raise InputError(
                f"{call}: there is a load {name!r} already; give another name, or take that one "
                f"away with scene.remove_load({name!r})."
            )

    def add_load(self, load: MembraneLoad) -> None:
        """Internal: add a load that has been made on the current shape."""
        self._loads = (*self._loads, load)
        self.versions.change_model(acts=load.factor != 0.0)

    @property
    def factors(self) -> dict[str, float]:
        """Current factors of the loads, by their names."""
        return {load.name: load.factor for load in self.loads}

    def load(self, name: str) -> MembraneLoad:
        """The load with a name.

        Raises
        ------
        InputError
            There is none.
        """
        return checks.named("load", {load.name: load for load in self.loads}, name)
