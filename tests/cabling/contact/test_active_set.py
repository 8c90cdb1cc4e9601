"""How often cables may turn slack and taut in a solve."""

from __future__ import annotations

from cabled_square import CABLE, sheet
from mpi4py import MPI

from crms_fenicsx.cabling.contact.active_set import ActiveSet
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import BUDGET


def slack(comm: MPI.Intracomm) -> tuple[LaidCable, ActiveSet]:
    """A cable longer than its path, and the active set of its net."""
    scene = sheet(comm, 4, "structured")
    cable = scene.lay_cable(CABLE, [(0.0, 50.0), (100.0, 50.0)], L0=101.0)
    return cable, ActiveSet(scene.net, None)


def test_a_cable_may_slacken_on_each_trial_of_paths(comm: MPI.Intracomm) -> None:
    """A rejected trial leaves it taut, as it was before."""
    cable, active = slack(comm)
    for _ in range(2 * BUDGET.switches):
        cable.update(taut=True)
        assert active.tighten() == [f"{cable.name} slackens"]
    assert not active.cycling_cable()


def test_a_cable_that_keeps_turning_on_the_same_path_is_named(comm: MPI.Intracomm) -> None:
    cable, active = slack(comm)
    active.tighten()
    shape = active.net.strip_shape()
    for _ in range(BUDGET.switches + 1):
        assert not active.cycling_cable()
        cable.update(taut=True)
        assert active.update(shape) == [f"{cable.name} slackens"]
    assert active.cycling_cable() == cable.name
