"""Distribution of independent work items, known to all ranks, over the ranks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from mpi4py import MPI

from crms_fenicsx.foundation.runtime.errors import raised_together

Item = TypeVar("Item")
Result = TypeVar("Result")


def share_out(
    comm: MPI.Intracomm, items: Sequence[Item], work: Callable[[Item], Result]
) -> list[Result]:
    """Apply `work` to each item on one rank; return all results on all ranks. Collective. The work
    must not communicate; its side effects stay on the rank that does it."""
    with raised_together(comm):
        mine = [work(item) for item in items[comm.rank :: comm.size]]
    if comm.size == 1:
        return mine
    parts = comm.allgather(mine)
    return [parts[i % comm.size][i // comm.size] for i in range(len(items))]
