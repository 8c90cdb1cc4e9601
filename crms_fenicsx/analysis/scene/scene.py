"""The scene: a membrane with its supports, cables and loads, in its current state."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Concatenate, Literal, ParamSpec, TypeVar

from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx.analysis.scene.design import Design
from crms_fenicsx.analysis.scene.frame import Frame
from crms_fenicsx.analysis.scene.loads import Air, Loads
from crms_fenicsx.analysis.scene.state import LoadCase, SceneState
from crms_fenicsx.cabling.cables.cable_net import CableNet
from crms_fenicsx.energy.terms.term import EnergyTerm, checked_energy
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Finite, PerRank, Positive, Whole, collective
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices
from crms_fenicsx.foundation.runtime.checks import counted, span
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.foundation.runtime.handle import ReadOnly
from crms_fenicsx.model.bar import Joint, PlacedBar
from crms_fenicsx.model.cable import Cable, Clamp, Hold, Net
from crms_fenicsx.model.cable_state import LaidAs
from crms_fenicsx.model.changed_materials import checked_materials
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.membrane import Marker, Membrane, StepHistory, warn_of_penalty
from crms_fenicsx.model.membrane_load import Pond
from crms_fenicsx.model.versions import UNBALANCED, StateWarning, Versions, changes_model

ANOTHER = "make another Scene(...)"
"""Remedy named when a property fixed at construction is assigned."""

Law = Literal["total", "step"]
PressureLaw = Literal["total", "lagged", "step"]


Part = TypeVar("Part")
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def of_part(
    name: str, method: Callable[Concatenate[Part, Arguments], Result]
) -> Callable[Concatenate[Any, Arguments], Result]:
    """A scene's method that forwards to a method of one of its parts."""

    @functools.wraps(method)
    def call(scene: Any, /, *args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        __tracebackhide__ = True
        return method(getattr(scene, name), *args, **kwargs)

    return call


PARTS = ("membrane", "loads", "air", "frame", "net")
"""Parts that own a scene's state, by their names in `Scene` and `SceneState`."""


class Scene:
    """A cable-reinforced membrane structure and its current state, in any consistent units.

    Parameters
    ----------
    mesh
        The stress-free membrane.
    material
        Material of the membrane, or of each of its parts by name.
    strain
        "total": Green-Lagrange strain from the stress-free shape. "step": the paper's incremental
        strain, linear in a step and aligned to a side of each cell, (2.3-3 ... 2.3-14).
    pressure
        "total": the exact follower pressure. The rim of the pressurised surface must be held, or
        slide in planes x, y or z = constant that are held in their normal direction, as planes of
        symmetry. "lagged": the nodal forces that the follower pressure has at a step's start. The
        rim may be free; steps are then repeated until these forces are those of the step's end.
        "step": the paper's nodal forces, (2.4-1, 2), which also keep direction and size in a step,
        but leave fold points unloaded: corners of a folded cell carry the pressure on the triangle
        between them.
    pressure_on
        The parts of the mesh on which pressure acts; all by default. Leave out a wall below the
        roof, which has the same air on both sides.
    penalty
        Factor c of the penalty mu = c E t A that keeps unfolded cells flat triangles; stable and
        free of locking from 1e-3 to 1.
    literal_penalty
        The paper's uniform coefficient mu = nu of (2.5-1) instead (force x length).
    frames : (n, 2, 3)
        For this rank's cells with individual stress-free shapes, from `patterns.sew`: images in the
        mesh of their unit vectors along warp and weft.

    Raises
    ------
    InputError
        An unknown part, cells without a material or with several, or step-wise strain with a
        material that wrinkles.

    Warns
    -----
    PenaltyWarning
        A penalty factor outside the range in which folded cells are sound.

    Examples
    --------
    >>> mesh = meshes.rectangle(MPI.COMM_WORLD, 4.0, 4.0, size=1.0)
    >>> scene = Scene(mesh, IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0))
    >>> scene.fix("boundary")
    >>> scene.lay_cable(Cable(EA=1e3), [(0.0, 2.0), (4.0, 2.0)], name="ridge").taut
    False
    """

    mesh: ReadOnly[MembraneMesh] = ReadOnly("membrane.mesh", ANOTHER)
    """The stress-free membrane."""
    V: ReadOnly[fem.FunctionSpace] = ReadOnly("membrane.V", ANOTHER)
    """Function space of the displacements."""
    u: ReadOnly[fem.Function] = ReadOnly("membrane.u", "write to its array, scene.u.x.array[:]")
    """Displacement of the vertices from the stress-free shape (length)."""
    held: ReadOnly[Booleans] = ReadOnly("membrane.held", "call scene.fix(...)")
    """Held components of the vertices, by local degree of freedom."""
    materials: ReadOnly[dict[int, MembraneMaterial]] = ReadOnly(
        "membrane.materials", "call scene.set_material(...)"
    )
    """Materials by the numbers of the parts of the mesh."""
    comm: ReadOnly[MPI.Intracomm] = ReadOnly("membrane.comm", ANOTHER)
    """Communicator of the mesh."""
    pressure: ReadOnly[float] = ReadOnly("air.pressure", "call solver.advance(pressure=...)")
    """Current pressure (force per area)."""
    loads: ReadOnly[Loads] = ReadOnly("_loads", "call scene.put_load(...) and the like")
    """Loads on the membrane and on joints, and ponds."""
    air: ReadOnly[Air] = ReadOnly(
        "_air", "call solver.advance(pressure=...) or scene.air.seal(...)"
    )
    """The air under the membrane."""
    design: ReadOnly[Design] = ReadOnly("_design", "call scene.set_strengths(...)")
    """Design values and limits that judge the results."""
    frame: ReadOnly[Frame] = ReadOnly("_frame", "call scene.add_bar(...)")
    """Bars and their joints."""
    cables: ReadOnly[tuple[LaidCable, ...]] = ReadOnly(
        "net.cables", "call scene.lay_cable(...) or scene.remove(...)"
    )
    """The laid cables, in order."""
    clamps: ReadOnly[tuple[Clamp, ...]] = ReadOnly("net.clamps", "call scene.clamp(...)")
    """The clamps between cables."""
    joints: ReadOnly[tuple[Joint, ...]] = ReadOnly("frame.joints", "call scene.add_joint(...)")
    """The joints of bars, including anchors, in the order of addition."""
    bars: ReadOnly[tuple[PlacedBar, ...]] = ReadOnly("frame.bars", "call scene.add_bar(...)")
    """The bars, in the order of addition."""
    warnings: ReadOnly[tuple[StateWarning, ...]] = ReadOnly("_warnings", "call solver.advance(...)")
    """Warnings of load steps on the current state; snap-throughs stay until an earlier state is
    restored."""
    energies: ReadOnly[Mapping[str, float]] = ReadOnly("_energies", "call solver.advance(...)")
    """Energy of each kind of term in the current state (force x length)."""
    step_history: ReadOnly[StepHistory | None] = ReadOnly(
        "_step_history", "call solver.advance(...)"
    )
    """Data of previous load steps for the step-wise laws; None before the first step."""
    terms: ReadOnly[tuple[EnergyTerm, ...]] = ReadOnly("_terms", "call scene.add_term(term)")
    """The energy terms added by the user."""
    floor_level: ReadOnly[float | None] = ReadOnly("_floor_level", "call scene.floor(z)")
    """Height of the floor (length), see `floor`; None without one."""
    strain_law: ReadOnly[Law] = ReadOnly("_strain_law", "pass it to Scene(..., strain=...)")
    """Strain law, as given to the scene."""
    pressure_law: ReadOnly[PressureLaw] = ReadOnly("_pressure_law", ANOTHER)
    """Pressure law, as given to the scene."""
    penalty: ReadOnly[float] = ReadOnly("_penalty", "pass it to Scene(..., penalty=...)")
    """Penalty factor, as given to the scene."""
    literal_penalty: ReadOnly[float | None] = ReadOnly(
        "_literal_penalty", "pass it to Scene(..., literal_penalty=...)"
    )
    """Penalty coefficient, as given to the scene; None with a factor."""

    case: ReadOnly[LoadCase] = ReadOnly("_case", "call solver.combine(...)")
    """What the state is for: its limit state, and the state in operation before its loads."""

    factors: ReadOnly[dict[str, float]] = ReadOnly("loads.factors", "call solver.advance(load=...)")
    """Current factors of loads and ponds, by name."""
    ponds: ReadOnly[tuple[Pond, ...]] = ReadOnly("loads.ponds", "call scene.put_pond(...)")
    """The ponds, with their current levels, volumes and factors."""
    volume: ReadOnly[float] = ReadOnly("air.volume", "call solver.advance(...)")
    """Volume gained under the cells under pressure since the stress-free shape (length cubed), see
    `Air.volume`."""

    put_load = of_part("loads", Loads.put_load)
    put_wind = of_part("loads", Loads.put_wind)
    put_forces = of_part("loads", Loads.put_forces)
    put_line_load = of_part("loads", Loads.put_line_load)
    put_cable_load = of_part("loads", Loads.put_cable_load)
    put_joint_load = of_part("loads", Loads.put_joint_load)
    put_temperature = of_part("loads", Loads.put_temperature)
    put_pond = of_part("loads", Loads.put_pond)
    load = of_part("loads", Loads.load)
    remove_load = of_part("loads", Loads.remove_load)
    seal = of_part("air", Air.seal)
    unseal = of_part("air", Air.unseal)
    add_joint = of_part("frame", Frame.add_joint)
    vertex_at = of_part("frame", Frame.vertex_at)
    add_bar = of_part("frame", Frame.add_bar)
    bar = of_part("frame", Frame.bar)
    joint = of_part("frame", Frame.joint)
    set_strengths = of_part("design", Design.set_strengths)
    set_limits = of_part("design", Design.set_limits)

    @collective
    def __init__(
        self,
        mesh: MembraneMesh,
        material: MembraneMaterial | Mapping[str, MembraneMaterial],
        *,
        strain: Law = "total",
        pressure: PressureLaw = "total",
        pressure_on: Sequence[str] | None = None,
        penalty: Positive = 0.1,
        literal_penalty: Positive | None = None,
        frames: PerRank[Array | None] = None,
    ) -> None:
        self._strain_law, self._pressure_law = strain, pressure
        self._penalty, self._literal_penalty = penalty, literal_penalty
        self.membrane = Membrane(mesh, material, pressure_on, frames)
        if literal_penalty is None:
            warn_of_penalty(self.comm, self.penalty)
        if strain == "step":
            self.membrane.refuse_step_strain()
        self.versions = Versions()
        """Version numbers of model and state, and the state in equilibrium."""
        self.net = CableNet(self.membrane)
        self._frame = Frame(self.membrane, self.versions)
        self._loads = Loads(self.net, self.versions, self.frame)
        self._air = Air(self.net, self.versions, pressure)
        self._design = Design(self.membrane, self.frame, self.net)
        self._floor_level: float | None = None
        self._terms: tuple[EnergyTerm, ...] = ()
        self._energies: Mapping[str, float] = {}
        self._warnings: tuple[StateWarning, ...] = ()
        self._step_history: StepHistory | None = None
        self._case = LoadCase()

    @property
    def state(self) -> SceneState:
        """Everything that load steps, supports, loads and cables can change, as one value."""
        parts: dict[str, Any] = {name: getattr(self, name).state for name in PARTS}
        return SceneState(
            **parts, floor=self.floor_level, energies=self.energies, warnings=self.warnings,
            step_history=self.step_history, terms=self.terms, version=self.versions.current,
            scene=self, case=self.case,
        )  # fmt: skip

    @state.setter
    def state(self, state: SceneState) -> None:
        for name in PARTS:
            getattr(self, name).state = getattr(state, name)
        self._floor_level, self._terms = state.floor, state.terms
        self._energies, self._warnings = state.energies, state.warnings
        self._step_history, self.versions.current = state.step_history, state.version
        self._case = state.case

    def record(
        self,
        *,
        energies: Mapping[str, float] | None = None,
        warnings: tuple[StateWarning, ...] | None = None,
        step_history: StepHistory | None = None,
        case: LoadCase | None = None,
    ) -> None:
        """Take over results of a load step besides the states of the parts, or what it is for."""
        self._case = self._case if case is None else case
        self._energies = self._energies if energies is None else dict(energies)
        self._warnings = self._warnings if warnings is None else warnings
        self._step_history = self._step_history if step_history is None else step_history

    @property
    def energy(self) -> float:
        """Total potential energy of the current state (force x length)."""
        return sum(self.energies.values())

    @property
    def dissipated(self) -> float:
        """Energy dissipated by friction in all load steps (force x length)."""
        return self.net.dissipated

    def positions(self) -> Array:
        """Current positions (n, 3) of the vertices by local degree of freedom, with ghosts.

        Examples
        --------
        >>> float(scene.positions()[:, 2].max().round(2))
        0.18
        """
        return self.membrane.positions()

    def vertices(self, where: str | Marker) -> Indices:
        """Local degrees of freedom of vertices in a named group or marked by a function.

        Collective; see `Membrane.vertices`.

        Examples
        --------
        >>> corner = scene.vertices("front left")
        >>> scene.positions()[corner]
        array([[0., 0., 0.]])
        >>> right = scene.vertices(lambda x: x[0] > 3.99)
        """
        return self.membrane.vertices(where)

    @collective
    @changes_model
    def fix(self, where: str | Marker, directions: str = "xyz") -> None:
        """Hold vertices at their current displacement.

        A group of edges held in all directions is held over its whole length: its edges stay
        straight, and cables that cross them slide along them. With points and marked vertices,
        edges between them can fold.

        Parameters
        ----------
        where
            As for `vertices`; "boundary" is the membrane's whole boundary.
        directions
            Held components of the displacement, out of "xyz".

        Raises
        ------
        InputError
            Unknown vertices or directions, or edges that cables already cross.

        Examples
        --------
        >>> sail = Scene(mesh, fabric)
        >>> sail.fix("front left")
        >>> sail.fix("back", "xz")
        >>> sail.fix(lambda x: x[0] > 3.99, "z")
        """
        self.membrane.hold(where, directions, new_edges=not self.cables)

    @collective
    @changes_model
    def release(self, where: str | Marker | Joint, directions: str = "xyz") -> None:
        """Release vertices of the membrane, or a joint, as when a temporary support is removed.

        Vertices that belong to edges which stay held over their length stay held, too.

        Parameters
        ----------
        where
            As for `vertices`, or a joint, or the name of one, that is held in space. An end of a
            cable at such a joint goes on with the bars that the joint has.
        directions
            Released components of the displacement, out of "xyz".

        Raises
        ------
        InputError
            On all ranks: nothing that is held there, unknown directions, a held edge after cables
            have been laid, a vertex at which a cable has an anchor of its own, which would stay
            behind, or a joint without bars.

        Examples
        --------
        >>> crane = scene.add_joint((2.0, 1.5, 4.0), name="hook", held="xyz")
        >>> for foot in ((0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (2.0, 3.0, 0.0)):
        ...     bar = scene.add_bar(Bar(EA=1e4), foot, crane)
        >>> scene.release("hook")
        """
        checks.directions("release", directions)
        named = {joint.name: joint for joint in self.joints}
        joint = where if not isinstance(where, str) else named.get(where)
        if isinstance(joint, Joint):
            self.frame.release(joint, directions)
        else:
            self.net.release(where, directions)  # type: ignore[arg-type]

    @collective
    @changes_model
    def floor(self, z: Finite = 0.0) -> None:
        """Put a rigid, frictionless floor at height z: no vertex or fold point goes below it.

        Raises
        ------
        InputError
            A membrane that is below it.

        Examples
        --------
        >>> scene.floor(-0.05)
        >>> step = solver.advance(pressure=-0.5)
        >>> float(scene.positions()[:, 2].min().round(3))
        -0.05
        """
        self.membrane.check_finite("floor")
        heights = self.positions()[:, 2]
        with raised_together(self.comm):
            if len(heights) and heights.min() < z:
                raise InputError(
                    f"floor: the membrane is at z = {heights.min():g}, below the floor z = {z:g}; "
                    "put the floor lower."
                )
        self._floor_level = z

    @collective
    @changes_model
    def add_term(self, term: EnergyTerm) -> None:
        """Add a user's term to the potential energy, which load steps minimise.

        `energies` has its energy under its name; its forces are loads, which supports carry.
        Checkpoints do not store terms: a script that resumes from one adds them again. A term of
        single vertices follows those of lines that slide over the fabric; hold these lines with
        ``Solver(slide=False)`` if it must not.

        Parameters
        ----------
        term
            See `EnergyTerm`; `taylor_test` checks its derivatives.

        Raises
        ------
        InputError
            On all ranks: no `EnergyTerm`, a name that is taken, or sums, energy or forces that are
            not finite in the current state.
        """
        self.membrane.check_finite("add_term")
        taken = [other.name for other in self.terms]
        term, energy = checked_energy(term, self.u, self.membrane.cell_tags, taken)
        self._terms = (*self._terms, term)
        self.record(energies={**self.energies, term.name: energy})

    def cable(self, name: str) -> LaidCable:
        """Return the cable with a name.

        Raises
        ------
        InputError
            No cable has that name.

        Examples
        --------
        >>> scene.cable("ridge").taut
        True
        """
        return self.net.cable(name)

    @collective
    @changes_model
    def lay_cable(
        self,
        cable: Cable,
        path: Sequence[Sequence[float] | Joint] | Array | None = None,
        *,
        along: str | None = None,
        L0: float | None = None,
        tension: float | None = None,
        shortest: bool = False,
        hold: Hold = "outside",
        layer: Whole = 0,
        name: str | None = None,
        measured_on: Literal["surface", "facets"] = "surface",
    ) -> LaidCable:
        """Lay a cable on the membrane's current shape.

        The cable lies on the membrane's outer side and spans hollows in a straight line, and holes
        from edge to edge unless it is in a pocket or bonded; at a seam of three or more parts it
        stays on those that bound the outer side. It is just taut unless
        `L0` or `tension` is given. An end on a held edge is held there; moved along the boundary it
        passes from edge to edge, moved off it slides over the edge. Elsewhere on the membrane an
        end is tied to its place. In load steps the cable slides as far as friction permits, also
        sideways, lifts off and touches down.

        Parameters
        ----------
        cable
            Data of the cable.
        path
            Points of its path, in plan (k, 2) or in space (k, 3) (length). A first or last point in
            space off the membrane is an anchor, from which the cable runs straight to the membrane:
            from beyond the boundary to the first contact, from above the membrane to the place
            below. A `Joint` as first or last point (the others in space) holds the end. With
            `along`, only the first and last point count, and may be left out.
        along
            A line of the mesh on which the cable lies, instead of a path: a group of edges that
            form one open line, such as those of `meshes.along`. The cable runs from vertex to
            vertex, and nothing is searched. Its first and last point, if given, are those of
            `path`: the line's ends or anchors off the membrane. Otherwise it starts at the end with
            the smaller x, or y, or z on the stress-free membrane. "outside" and in a "sleeve" it
            slides sideways with its line: the stress-free mesh moves, ``mesh.geometry.x``.
        L0
            Unstressed length (length).
        tension
            Tension at laying (force), which determines the unstressed length.
        shortest
            Whether to lay the cable along the shortest path on the membrane near `path`, the
            position of a frictionless cable.
        hold
            Connection of the cable to the membrane:

            * "outside": none; it slides and lifts off.
            * "sleeve": it slides, also sideways, but cannot lift off.
            * "pocket": it slides along itself only, on its line sewn to the fabric. A cable along
              free edges does so in any case.
            * "bonded": it does not slide at all, like sewn-on belts and bolt ropes; each segment
              between two sides of cells has its own tension, `LaidCable.tensions`.

            Friction is ignored in directions in which the cable cannot slide.
        layer
            Of two crossing cables the one with the higher layer lies on top; for equal layers, the
            later one.
        name
            Name in results; by default that of the line, or "cable 1", "cable 2" ...
        measured_on
            Without `L0`: whether the length is measured on the smooth "surface" through the
            vertices, or on the inscribed "facets", where it is too short; ``Cable(law="step")`` and
            bonded cables use the facets.

        Returns
        -------
        LaidCable
            The cable, a handle for load steps and results.

        Raises
        ------
        PathError
            The path leaves the membrane for good or with a cable that cannot span the hole, could
            only pass behind it, starts inside it, leads to a part behind a seam, or returns through
            the cells where it left.
        InputError
            An L0 or tension that is not positive, both of them, a name in use, neither path nor
            line, a line that the mesh does not have, with `shortest`, or with a path that ends
            elsewhere.

        Examples
        --------
        >>> steel = Cable(EA=1e3)
        >>> diagonal = scene.lay_cable(steel, [(0.0, 1.0), (4.0, 3.0)], tension=4.0)
        >>> anchors = [(2.0, -1.0, -0.5), (2.0, 5.0, -0.5)]
        >>> guyed = scene.lay_cable(steel, anchors, hold="sleeve")
        >>> step = solver.advance()
        >>> round(diagonal.tension, 1), guyed.hold
        (3.2, 'sleeve')

        Along a line of the mesh:

        >>> roof = Scene(meshes.along(mesh, {"valley": [(0.0, 1.0), (4.0, 3.0)]}), fabric)
        >>> valley = roof.lay_cable(steel, along="valley", hold="pocket", tension=4.0)
        >>> valley.name, valley.line[0]
        ('valley', array([0., 1., 0.]))
        """
        from crms_fenicsx.cabling.paths.laying import lay

        self.membrane.check_finite("lay_cable")
        route, joints = self.frame.path_of(path)
        return lay(
            self.net, cable, route, LaidAs(hold, layer, joints, line=along), L0=L0,
            tension=tension, shortest=shortest, name=name, measured_on=measured_on,
        )  # fmt: skip

    @collective
    @changes_model
    def lay_net(
        self,
        net: Net,
        cable: Cable,
        *,
        tension: float | None = None,
        hold: Hold = "outside",
        clamped: bool = False,
    ) -> tuple[LaidCable, ...]:
        """Lay a cable on each line of a net, under the line's name. Collective.

        Later families lie on top. On a mesh that has the net's lines, from
        ``meshes.along(mesh, net.paths)``, the cables lie along these and take them along where they
        slide, as with ``lay_cable(along=...)``: this takes a fraction of the time. On a mesh
        without them the cables fold the cells that they cross.

        Parameters
        ----------
        net
            A layout from `crms_fenicsx.nets`.
        cable, tension, hold
            As for `lay_cable`, the same for all lines.
        clamped
            Whether to clamp all crossings, as `clamp` does, on a mesh that has the net's lines.

        Returns
        -------
        tuple of LaidCable
            The cables, in the order of ``net.lines``.

        Raises
        ------
        PathError, InputError
            As for `lay_cable` and `clamp`, or the mesh has other lines of these names, or some of
            them only; then no cable is laid.

        Examples
        --------
        >>> net = nets.sections(scene, angles=(0.0,), offsets=[1.0, 3.0])
        >>> cables = scene.lay_net(net, Cable(EA=1e3), tension=5.0)
        >>> round(scene.cable("A1").tension, 6)
        5.0

        Along lines of the mesh, which are made on its stress-free shape:

        >>> net = nets.sections(Scene(mesh, fabric), angles=(0.0,), offsets=[1.0, 3.0])
        >>> roof = Scene(meshes.along(mesh, net.paths), fabric)
        >>> [cable.name for cable in roof.lay_net(net, Cable(EA=1e3), hold="pocket")]
        ['A1', 'A2']
        """
        from crms_fenicsx.cabling.cables.cable_net import refuse_clamps_off_lines
        from crms_fenicsx.cabling.paths.laying import has_lines, lay_net

        self.membrane.check_finite("lay_net")
        before, lined = self.net.state, has_lines(self.mesh, net)
        if clamped and not lined:
            refuse_clamps_off_lines([line.name for line in net.lines])
        try:
            if lined:
                laid = lay_net(self.net, net, cable, tension, hold)
            else:
                laid = tuple(
                    self.lay_cable(cable, line.path, tension=tension, hold=hold, name=line.name)
                    for line in net.lines
                )
            if clamped:
                self.clamp(*laid)
            return laid
        except InputError:
            self.net.state = before
            raise

    @collective
    @changes_model
    def clamp(
        self,
        *cables: LaidCable | str,
        near: Sequence[Sequence[float]] | Array | None = None,
        slip: Positive | None = None,
    ) -> tuple[Clamp, ...]:
        """Clamp cables along lines of the mesh to each other where they cross. Collective.

        A clamp fixes the cables to each other, not to the membrane: it slides over it, lifts off
        and touches down. Clamps of three or more cables at one point are one. Each cable has one
        tension from clamp to clamp, `LaidCable.tensions`, which varies only with friction along it.
        The unstressed lengths between clamps are those at clamping; a load step that changes a
        cable's L0 scales them alike. Clamping does not disturb an equilibrium.

        Parameters
        ----------
        *cables
            Two or more cables of this scene, or their names.
        near
            Points in space, (k, 3) (length), whose nearest crossings are clamped; by default all
            crossings are.
        slip
            Grip of the clamps (force): a cable slips through where its tensions before and after
            the clamp would differ by more, which moves unstressed length from one part to the
            other; the work counts in `dissipated`. The grip acts on the unstressed cable: on the
            stretched one it is smaller by the strain. By default clamps never slip.

        Returns
        -------
        tuple of Clamp
            The new clamps; existing ones stay.

        Raises
        ------
        InputError
            On all ranks: cables across the cells, laid without ``along=`` or a net's lines; that
            do not cross between their ends, lie apart where they do, or have the step-wise law;
            two grips at one point.

        Warns
        -----
        NetWarning
            Some of three or more cables lie apart where they cross; these crossings stay open.

        Examples
        --------
        >>> routes = {"A1": [(0.0, 1.0), (4.0, 1.0)], "B2": [(2.5, 0.0), (2.5, 4.0)]}
        >>> roof = Scene(meshes.along(mesh, routes), fabric)
        >>> cables = [roof.lay_cable(Cable(EA=1e3), along=name) for name in routes]
        >>> (clamp,) = roof.clamp("A1", "B2")
        >>> clamp.name, clamp.place
        ('A1 x B2', array([2.5, 1. , 0. ]))
        """
        return self.net.clamp(cables, near, slip)

    @collective
    @changes_model
    def unclamp(
        self, *cables: LaidCable | str, near: Sequence[Sequence[float]] | Array | None = None
    ) -> None:
        """Open clamps, so that the cables slide in the next load step. Collective.

        Parameters
        ----------
        *cables, near
            As for `clamp`: all clamps between the cables, or those nearest to the points.

        Raises
        ------
        InputError
            On all ranks: an unknown clamp.

        Examples
        --------
        >>> scene.unclamp("A1", "B2")
        >>> len(scene.clamps)
        0
        """
        self.net.unclamp(cables, near)

    @collective
    @changes_model
    def remove(self, cable: LaidCable | str) -> None:
        """Remove a cable from the next load step on. Collective.

        Cables that crossed it then lie on the membrane, or on the cables below. `dissipated` keeps
        the energy of its friction; tables and pictures keep its history. A new cable may take its
        name.

        Parameters
        ----------
        cable
            A cable of this scene, or its name.

        Raises
        ------
        InputError
            On all ranks: an unknown cable.

        Examples
        --------
        >>> scene.remove("ridge")
        >>> step = solver.advance()
        >>> scene.cables
        ()
        """
        self.net.remove(cable)

    @collective
    @changes_model
    def remove_bar(self, bar: PlacedBar | str) -> None:
        """Remove a bar, and anchors that nothing else needs, from the next load step on.

        Collective. Joints stay.

        Parameters
        ----------
        bar
            A bar of this scene, or its name.

        Raises
        ------
        InputError
            On all ranks: an unknown bar.

        Examples
        --------
        >>> corner = scene.vertex_at((4.0, 4.0, 0.0))
        >>> mast = scene.add_bar(Bar(EA=1e5), (4.0, 4.0, -3.0), corner)
        >>> scene.remove_bar(mast)
        >>> len(scene.bars)
        0
        """
        if isinstance(bar, str):
            bar = self.frame.bar(bar)
        checks.own("remove_bar", "bar", bar, self.bars)
        used: set[str | None] = {name for load in self.loads for name in load.joints}
        used |= {name for cable in self.cables for name in cable.state.laid.joints}
        self.frame.remove(bar, used)

    @collective
    @changes_model
    def set_material(self, material: MembraneMaterial | Mapping[str, MembraneMaterial]) -> None:
        """Change the numbers of the membrane's materials from the next load step on. Collective.

        For parameter studies: no form is compiled again.

        Parameters
        ----------
        material
            One for all, or some of the materials by their parts as given to `Scene`, with the same
            classes, warps and wrinkling.

        Raises
        ------
        InputError
            On all ranks: an unknown part, a material that differs by more than numbers, or the
            paper's step-wise strain, whose stresses add up over the steps.

        Examples
        --------
        >>> for E in (300.0, 450.0, 600.0):
        ...     scene.set_material({"roof": IsotropicMembrane(E=E, nu=0.3, thickness=1.0)})
        ...     solver.advance()
        """
        if self.strain_law == "step":
            raise InputError(
                'set_material: strain="step" continues from the stresses of the last material; use '
                'strain="total", or make another Scene(...).'
            )
        self.membrane.materials.update(checked_materials(self.membrane, material))

    @collective
    @changes_model
    def set_stiffness(self, EA: Mapping[LaidCable | PlacedBar, float]) -> None:
        """Change the axial stiffness of cables and bars from the next load step on. Collective.

        They keep their unstressed lengths.

        Parameters
        ----------
        EA
            Axial stiffness (force) by cables and bars of this scene.

        Raises
        ------
        InputError
            On all ranks: no cable or bar of this scene, or a stiffness that is not positive.

        Examples
        --------
        >>> scene.set_stiffness({ridge: 2 * ridge.cable.EA})
        >>> solver.advance()
        """
        checks.collection("set_stiffness: EA", EA, Mapping, "{cable: EA}", 1)
        for one, stiffness in EA.items():
            checks.own("set_stiffness", "cable or bar", one, (*self.cables, *self.bars))
            checks.positive(f"set_stiffness: EA of {one.name!r}", stiffness)
        for one, stiffness in EA.items():
            if isinstance(one, LaidCable):
                one.update(cable=replace(one.cable, EA=float(stiffness)))
            else:
                one.update(bar=replace(one.bar, EA=float(stiffness)))

    def in_equilibrium(self) -> bool:
        """Whether nothing has changed since the last load step. Collective."""
        settled = self.versions.are_settled(self.membrane.owned_u)
        return bool(self.comm.allreduce(settled, op=MPI.LAND))

    def require_equilibrium(self, call: str) -> None:
        """Raise an error unless the last load step found the current state. Collective.

        Raises
        ------
        InputError
            On all ranks: the state has changed since, or there was no load step.
        """
        if not self.in_equilibrium():
            raise InputError(f"{call}: {self.versions.trouble}; call solver.advance() before.")

    def __repr__(self) -> str:
        """One line; not collective."""
        mesh, cables = self.membrane.mesh.mesh, self.net.cables
        loads = {"pressure": self.pressure, **self.loads.factors}
        words = [
            counted(mesh.topology.index_map(2).size_global, "cell"),
            ", ".join(f"{name} {factor:.6g}" for name, factor in loads.items()),
        ]
        if cables:
            tensions = span([cable.tension for cable in cables])
            words.append(f"{counted(len(cables), 'cable')}, tension {tensions}")
        if self.bars:
            forces = span([bar.force for bar in self.bars])
            words.append(f"{counted(len(self.bars), 'bar')}, force {forces}")
        solved = self.versions.current.equilibrium is not None
        if solved and not self.versions.are_settled(self.membrane.owned_u):
            words.append(UNBALANCED)
        return f"Scene({'; '.join(words)})"


def place_stress_free(scene: Scene, X: Array) -> None:
    """Move the stress-free places of a scene's vertices to X, (n, 3) with ghosts, as lines that
    slide with their cables do; displacements stay. Everything that depends on them follows in the
    next load step or inspection. Collective."""
    if "step" in (scene.strain_law, scene.pressure_law):
        raise InputError(
            "lines of the mesh slide and move its stress-free vertices, which the step-wise laws "
            'of the membrane cannot follow; use strain="total" and pressure="total", or hold the '
            "lines with slide=False."
        )
    if told := [term.name for term in scene.terms if term.has_history]:
        raise InputError(
            f"lines of the mesh slide and move its stress-free vertices, which {told[0]!r}, a term "
            "with a history, cannot follow; hold the lines with slide=False."
        )
    scene.membrane.place_stress_free(X)
    scene.loads.follow_stress_free_places()
    scene.versions.change_model()
