"""Changes of contacts and of paths that are solved together."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import clamped
from dome import STADIUM_HEIGHT, STADIUM_RADIUS, stadium
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, nets
from crms_fenicsx.analysis.equilibrium.contact_loop import ContactLoop
from crms_fenicsx.cabling.contact.active_set import ActiveSet


def roof(comm: MPI.Comm) -> Scene:
    """A flat roof under two families of cables, some of which lift off as it is inflated."""
    scene = clamped(stadium(comm, size=5.1), IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3))
    for angle in np.radians([45.0, -45.0]):
        for offset in 8.5 * np.arange(-6.5, 7.0):
            path = nets.great_circle(STADIUM_RADIUS, STADIUM_HEIGHT, angle, offset)
            scene.lay_cable(Cable(EA=600e3), path=path)
    return scene


def test_paths_change_with_contacts_only_where_cables_lift_off(
    comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a cable touches down the energy before is lower than any after: no bound for paths."""
    update, solve = ActiveSet.update, ContactLoop.solve
    looks: list[bool] = []  # at paths: whether contacts change
    lifted: list[bool] = []

    def watched_update(self: ActiveSet, *args) -> list[str]:
        texts = update(self, *args)
        lifted.append(len(texts) > 0 and all(" lifts off " in text for text in texts))
        assert self.only_lifted == lifted[-1]
        return texts

    def watched_solve(self: ContactLoop, prestress, look=None):
        def watched(contacts_change: bool) -> bool:
            looks.append(contacts_change)
            assert self.active.only_lifted or not contacts_change
            return look(contacts_change)

        return solve(self, prestress, watched if look else None)

    monkeypatch.setattr(ActiveSet, "update", watched_update)
    monkeypatch.setattr(ContactLoop, "solve", watched_solve)
    Solver(roof(comm)).advance(pressure=0.3)
    assert any(looks) and not all(looks)
    assert any(lifted) and not all(lifted)
