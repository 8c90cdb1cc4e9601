"""A membrane with the masts, struts and guys that hold it, and the loads on their joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from crms_fenicsx.loaded_membrane import LoadedMembrane
from crms_fenicsx.model.bar import Bar, BarEnd, Joint, MeshVertex, PlacedBar
from crms_fenicsx.model.frame import Frame
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.membrane_load import joint_load
from crms_fenicsx.model.versions import changes_model
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import InputError, collective
from crms_fenicsx.runtime.readonly import ReadOnly

Place = Sequence[float] | Array
"""A point in space, (3,) (length)."""


class BracedMembrane(LoadedMembrane):
    """A loaded membrane with bars between anchors, joints and its vertices.

    Parameters
    ----------
    membrane
        The membrane.
    """

    joints: ReadOnly[tuple[Joint, ...]] = ReadOnly("frame.joints", "call scene.add_joint(...)")
    """The joints, those of anchors included, in the order in which they were added."""
    bars: ReadOnly[tuple[PlacedBar, ...]] = ReadOnly("frame.bars", "call scene.add_bar(...)")
    """The bars, in the order in which they were added."""

    def __init__(self, membrane: Membrane) -> None:
        super().__init__(membrane)
        self.frame = Frame(membrane)

    @collective
    def add_joint(self, position: Place, *, name: str | None = None, held: str = "") -> Joint:
        """Add a joint off the membrane, at which bars end; its displacement is an unknown.

        Parameters
        ----------
        position
            Where it is, (3,) (length).
        name
            Name in messages and for loads; "joint 1", "joint 2" ... by default.
        held
            Held components of its displacement, out of "xyz".

        Raises
        ------
        InputError
            On all ranks: a position that is not finite, directions that are none, or a name that
            is taken.
        """
        checks.same(self.comm, "add_joint", position=position, name=name, held=held)
        joint = self.frame.add_joint(checks.vector("add_joint: position", position), name, held)
        self.versions.change_model(acts=False)
        return joint

    @collective
    def vertex_at(self, point: Place) -> MeshVertex:
        """The vertex of the membrane that is at a point now, for bars to end at. Collective.

        Parameters
        ----------
        point
            Its place, (3,) (length).

        Raises
        ------
        InputError
            On all ranks: no vertex is there; it says where the nearest is.
        """
        checks.same(self.comm, "vertex_at", point=point)
        self.membrane.check_finite("vertex_at")
        return self.frame.vertex_at(checks.vector("vertex_at: point", point))

    @collective
    @changes_model
    def add_bar(
        self,
        bar: Bar,
        start: Place | BarEnd | str,
        end: Place | BarEnd | str,
        *,
        L0: float | None = None,
        name: str | None = None,
    ) -> PlacedBar:
        """Add a bar: a mast, a strut or, with ``Bar(EA, tension_only=True)``, a guy. Collective.

        It is straight, has hinges at both ends, and knows nothing of the membrane between them.

        Parameters
        ----------
        bar
            Its data.
        start, end
            Where it ends: a point in space, which becomes an anchor of its own (a held joint,
            ``bar.start``); a joint; a vertex of the membrane from `vertex_at`; or the name of a
            group of one vertex.
        L0
            Unstressed length (length); by default the distance of its ends now.
        name
            Name in tables and pictures; "bar 1", "bar 2" ... by default.

        Returns
        -------
        PlacedBar
            The bar, as a handle for load steps and results.

        Raises
        ------
        InputError
            On all ranks: an end that is none, two ends at one place, an L0 that is not positive or
            a name that is taken.

        Examples
        --------
        >>> top = scene.add_joint((0.0, 0.0, 6.0), name="mast top")
        >>> mast = scene.add_bar(Bar(EA=1e5), (0.0, 0.0, 0.0), top, name="mast")
        >>> guy = scene.add_bar(Bar(EA=2e4, tension_only=True), top, (8.0, 0.0, 0.0), L0=9.98)
        >>> solver.advance(L0={guy: 9.95}, move={mast.start: (0.0, 0.0, 0.1)})
        >>> mast.force, mast.start.reaction
        """
        checks.same(self.comm, "add_bar", bar=bar, start=start, end=end, L0=L0, name=name)
        self.membrane.check_finite("add_bar")
        if not isinstance(bar, Bar):
            raise InputError(f"add_bar: {bar!r} is no Bar; write Bar(EA=...).")
        found = self.frame.bar_name(name)
        if L0 is not None:
            L0 = checks.positive(f"add_bar: L0 of {found!r}", L0)
        ends = self._bar_end(found, "start", start), self._bar_end(found, "end", end)
        placed = self.frame.add_bar(bar, ends, L0, found)
        return placed

    def _bar_end(self, name: str, which: str, given: Place | BarEnd | str) -> BarEnd | Array:
        """A joint, a vertex, or the place of an anchor, (3,). Collective."""
        if isinstance(given, Joint):
            if self.frame.number(given) < 0:
                raise InputError(
                    f"add_bar: {which} of {name!r} = {given!r} is a joint of another scene; add "
                    "one to this scene with scene.add_joint(...)."
                )
            return given
        if isinstance(given, MeshVertex):
            self.frame.home(given)
            return given
        if isinstance(given, str):
            return self.frame.vertex_in_group(given)
        return checks.vector(f"add_bar: {which} of {name!r}", given)

    @collective
    @changes_model
    def remove_bar(self, bar: PlacedBar | str) -> None:
        """Take a bar away, with the anchors that nothing else needs. Collective.

        The next load step finds the equilibrium without it. Joints stay.

        Parameters
        ----------
        bar
            A bar of this scene, or its name.

        Raises
        ------
        InputError
            On all ranks: there is no such bar.
        """
        checks.same(self.comm, "remove_bar", bar=bar)
        if isinstance(bar, str):
            bar = self.bar(bar)
        if not any(bar is own for own in self.bars):
            raise InputError(f"remove_bar: {bar!r} is not a bar of this scene.")
        self.frame.remove_bar(bar, self._used_joints())

    def _used_joints(self) -> set[str | None]:
        """Names of the joints that loads need."""
        return {name for load in self.loads for name in load.joints}

    def bar(self, name: str) -> PlacedBar:
        """The bar with a name.

        Raises
        ------
        InputError
            There is none.
        """
        return checks.named("bar", {bar.name: bar for bar in self.bars}, name)

    def joint(self, name: str) -> Joint:
        """The joint with a name; that of a bar's anchor is "start of mast" or "end of mast".

        Raises
        ------
        InputError
            There is none.
        """
        return checks.named("joint", {joint.name: joint for joint in self.joints}, name)

    @collective
    def put_joint_load(self, forces: Mapping[Joint, Place], *, name: str = "joint load") -> None:
        """Put forces on joints; `Solver.advance` brings them on by their factor. Collective.

        Parameters
        ----------
        forces
            Force on each joint, (3,) (force). They keep direction and size.
        name
            What load steps and results know the load by.

        Raises
        ------
        InputError
            On all ranks: what is no joint of this scene, a force that is not finite, or a name
            that is taken.

        Examples
        --------
        >>> scene.put_joint_load({top: (0.0, 0.0, -5.0)}, name="lamp")
        >>> solver.advance(load={"lamp": 1.35})
        """
        checks.same(self.comm, "put_joint_load", forces=forces, name=name)
        self._check_new_load("put_joint_load", name)
        if not isinstance(forces, Mapping) or not forces:
            raise InputError(
                f"put_joint_load: forces = {forces!r}; write {{joint: (Fx, Fy, Fz), ...}}."
            )
        found: dict[str, tuple[float, float, float]] = {}
        for joint, force in forces.items():
            if not isinstance(joint, Joint) or self.frame.number(joint) < 0:
                raise InputError(
                    f"put_joint_load: {joint!r} is no joint of this scene; give what "
                    "scene.add_joint(...) has returned."
                )
            x, y, z = map(float, checks.vector(f"put_joint_load: force on {joint!r}", force))
            found[joint.name] = (x, y, z)
        self.add_load(joint_load(self.membrane, found, name))

    @collective
    @changes_model
    def set_stiffness(self, EA: Mapping[LaidCable | PlacedBar, float]) -> None:
        """Give cables and bars another axial stiffness, for studies of parameters. Collective.

        They keep their unstressed lengths; the next load step goes to the equilibrium with it.

        Parameters
        ----------
        EA
            Axial stiffness (force) by cables and bars of this scene.

        Raises
        ------
        InputError
            On all ranks: what is no cable or bar of this scene, or a stiffness that is not
            positive.

        Examples
        --------
        >>> scene.set_stiffness({ridge: 2 * ridge.cable.EA})
        >>> solver.advance()
        """
        checks.same(self.comm, "set_stiffness", EA=EA)
        if not isinstance(EA, Mapping) or not EA:
            raise InputError(f"set_stiffness: EA = {EA!r}; write {{cable: EA, ...}}.")
        for one, stiffness in EA.items():
            if not any(one is own for own in self._stretched()):
                raise InputError(
                    f"set_stiffness: {one!r} is no cable or bar of this scene; give what "
                    "scene.lay_cable(...) or scene.add_bar(...) has returned."
                )
            checks.positive(f"set_stiffness: EA of {one.name!r}", stiffness)
        for one, stiffness in EA.items():
            one.set_stiffness(float(stiffness))

    def _stretched(self) -> tuple[LaidCable | PlacedBar, ...]:
        """What has an axial stiffness."""
        return self.bars
