"""Work on items that all ranks have, of which each is done on one rank."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from mpi4py import MPI

from crms_fenicsx.runtime.errors import raised_together

Item = TypeVar("Item")
Result = TypeVar("Result")


def share_out(
    comm: MPI.Intracomm, items: Sequence[Item], work: Callable[[Item], Result]
) -> list[Result]:
    """Results of some work on each item, on all ranks. Collective. The work must not communicate;
    what it changes on its rank, it changes there alone."""
    with raised_together(comm):
        mine = [work(item) for item in items[comm.rank :: comm.size]]
    if comm.size == 1:
        return mine
    parts = comm.allgather(mine)
    return [parts[i % comm.size][i // comm.size] for i in range(len(items))]
