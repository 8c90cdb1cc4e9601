"""Tables of elements, which can be told to other ranks: arrays, and which blocks they address."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Self

from crms_fenicsx.runtime.arrays import Indices


class ElementTable(ABC):
    """Base of the frozen dataclasses that hold elements of a term.

    Attributes: `addresses`: names of the fields that hold blocks.
    """

    addresses: ClassVar[tuple[str, ...]]

    @property
    @abstractmethod
    def element_blocks(self) -> tuple[Indices, Indices]:
        """Blocks of each element in CSR form: pointers (n + 1,), blocks (m,)."""

    def renumbered(self, number: Indices) -> Self:
        """The same elements of blocks with other numbers: block b becomes ``number[b]``."""
        return replace(self, **{name: number[getattr(self, name)] for name in self.addresses})  # type: ignore[type-var]

    @classmethod
    def joined(cls, tables: Sequence[Self]) -> Sequence[Self]:
        """The elements of tables of several processes in as few tables as a term of them needs."""
        return tables
