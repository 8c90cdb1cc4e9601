"""Fixtures that all tests share, and the rule which tests run under mpirun."""

import pytest
from mpi4py import MPI


@pytest.fixture(scope="session")
def comm() -> MPI.Intracomm:
    """All ranks. A test that has it runs on any number of them, and every other on one only."""
    return MPI.COMM_WORLD


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Under mpirun, skip what does not use `comm`: each rank would do the same once more."""
    if MPI.COMM_WORLD.size > 1:
        skip = pytest.mark.skip(reason="nothing in it is distributed")
        for item in items:
            if "comm" not in getattr(item, "fixturenames", ()):
                item.add_marker(skip)
