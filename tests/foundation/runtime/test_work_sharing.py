"""Work that is shared out among ranks, against a loop over all of it."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from crms_fenicsx.foundation.runtime.errors import MeshError
from crms_fenicsx.foundation.runtime.work_sharing import share_out


@pytest.mark.ranks
def test_results_are_in_the_order_of_the_items(comm: MPI.Intracomm) -> None:
    done = []

    def square(n: int) -> int:
        done.append(n)
        return n * n

    for count in range(2 * comm.size + 2):
        assert share_out(comm, range(count), square) == [n * n for n in range(count)]
    done.clear()
    share_out(comm, range(6 * comm.size), square)
    assert len(done) == 6, "each item on one rank"
    assert {n for own in comm.allgather(done) for n in own} == set(range(6 * comm.size))


@pytest.mark.ranks
def test_an_error_on_one_rank_is_raised_on_all(comm: MPI.Intracomm) -> None:
    def refuse(n: int) -> int:
        if n == comm.size - 1:
            raise MeshError(f"item {n} is bad")
        return n

    with pytest.raises(MeshError, match=f"item {comm.size - 1} is bad"):
        share_out(comm, range(comm.size), refuse)
    assert share_out(comm, range(comm.size - 1), refuse) == list(range(comm.size - 1))
