"""Fixtures that all tests share."""

import pytest
from mpi4py import MPI


@pytest.fixture
def comm() -> MPI.Intracomm:
    """All ranks: every test runs on any number of them."""
    return MPI.COMM_WORLD
