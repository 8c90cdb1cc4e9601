"""History of a run: one row of values per load step, in memory and in a CSV file."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from crms_fenicsx.foundation.runtime.checks import counted
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.foundation.runtime.files import (
    absolute,
    make_writable,
    read_text,
    readable,
    replaced,
)

MARK = "'"
"""Prefix of a text that a spreadsheet would take for a formula, or that starts with the prefix."""
CALCULATED = ("=", "+", "-", "@", "\t", "\r", "\n", MARK)


Value = int | float | str


class History:
    """Rows of named values; the file is complete after each row.

    A row may add columns, as for a cable laid later; other rows hold NaN there, or "" in a column
    of text. Floats are written with all digits, and texts that a spreadsheet would take for a
    formula with a leading apostrophe, which `read` removes.

    Parameters
    ----------
    path : str, Path or None
        CSV file, replaced by the first row; None keeps the rows in memory.
    comm : MPI communicator
        Its ranks append the same rows; rank 0 writes.

    Raises
    ------
    InputError
        On all ranks: a folder that cannot be written.
    """

    def __init__(self, path: str | Path | None, comm: MPI.Intracomm) -> None:
        self.path = None if path is None else absolute(path, comm)
        self.comm = comm
        self._columns: list[str] = []
        self._rows: list[dict[str, Value]] = []
        self._lines: list[str] = []
        with raised_together(comm):
            if self.path is not None and comm.rank == 0:
                make_writable(self.path.parent)
                if self.path.is_dir():
                    raise InputError(f"{self.path} is a folder; pass the name of a file.")

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns, in the order of their first appearance."""
        return tuple(self._columns)

    def __repr__(self) -> str:
        """One line."""
        return f"History({counted(len(self), 'row')}; {', '.join(self.columns)})"

    def _repr_html_(self) -> str:
        """The last rows as a table, for notebooks."""
        heads = "".join(f"<th>{escape(name)}</th>" for name in self.columns)
        rows = [f"<tr>{heads}</tr>"]
        for row in self._rows[-20:]:
            cells = "".join(f"<td>{_short(row.get(name))}</td>" for name in self.columns)
            rows.append(f"<tr>{cells}</tr>")
        return f"<table>{''.join(rows)}</table>"

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[dict[str, Value]]:
        return (dict(row) for row in self._rows)

    def __getitem__(self, column: str) -> NDArray[Any]:
        """Values of a column: integers, floats or texts; NaN or "" where missing."""
        if column not in self._columns:
            raise InputError(f"no column {column!r}; there are {self._columns}.")
        given = [row[column] for row in self._rows if column in row]
        if any(isinstance(value, str) for value in given):
            return np.array([row.get(column, "") for row in self._rows], dtype=str)
        if len(given) == len(self._rows) and all(isinstance(value, int) for value in given):
            return np.array(given, dtype=np.int64)
        return np.array([row.get(column, np.nan) for row in self._rows], dtype=np.float64)

    def append(self, row: Mapping[str, Value | np.generic]) -> None:
        """Append a row to history and file. Collective.

        Parameters
        ----------
        row : dict of int, float or str
            Values by column, the same on all ranks; numpy scalars are accepted.

        Raises
        ------
        InputError
            On all ranks: a value that is neither number nor text, text in a column of numbers or
            the reverse, or a file that cannot be written. The history is then unchanged.
        """
        with raised_together(self.comm):
            plain = {_name(column): _plain(column, value) for column, value in row.items()}
            for column, value in plain.items():
                before = next((row[column] for row in reversed(self._rows) if column in row), value)
                if isinstance(before, str) != isinstance(value, str):
                    raise InputError(
                        f"column {column!r} got {value!r} after {before!r}; keep text and numbers "
                        "in columns of their own."
                    )
            if not plain:
                raise InputError("an empty row for the history; include at least the step.")
            columns = self._columns + [name for name in plain if name not in self._columns]
            rows = [*self._rows, plain]
            if self.path is not None and self.comm.rank == 0:
                if columns == self._columns:
                    lines = [*self._lines, csv_line(plain.get(name, "") for name in columns)]
                else:
                    lines = [csv_line(old.get(name, "") for name in columns) for old in rows]
                with replaced(self.path) as partial:
                    partial.write_text(csv_line(columns) + "".join(lines), encoding="utf-8")
                self._lines = lines
        self._columns, self._rows = columns, rows

    def resume(self, rows: Iterable[Mapping[str, Value]]) -> None:
        """Replace all rows by those of an earlier run; the file follows with the next row.

        Parameters
        ----------
        rows
            Rows as a history yields them, the same on all ranks.

        Raises
        ------
        InputError
            As for `append`.
        """
        old = History(None, MPI.COMM_SELF)
        for row in rows:
            old.append(row)
        self._columns, self._rows = old._columns, old._rows
        self._lines = [csv_line(row.get(name, "") for name in self._columns) for row in self._rows]

    @classmethod
    def read(cls, path: str | Path) -> History:
        """Return the history in a CSV file, kept in memory; not collective.

        Columns are integers or numbers if all their values read as such, else text.

        Raises
        ------
        InputError
            A file that is missing or empty or has a row of another length.

        Examples
        --------
        >>> step = Solver(scene, results="results/roof").advance(pressure=1.1)
        >>> history = output.History.read("results/roof/history.csv")
        >>> history["pressure"]
        array([1.1])
        """
        with readable(f"the history {path}", "pass the CSV file that a run has written"):
            content = read_text(Path(path))
        try:
            cells = list(csv.reader(io.StringIO(content.decode("utf-8"), newline="")))
        except (UnicodeDecodeError, csv.Error) as error:
            raise InputError(
                f"the history {path} is not a table ({error}); pass the CSV file that a run "
                "has written."
            ) from None
        if not cells:
            raise InputError(f"the history {path} is empty; a run writes at least its header.")
        columns, *rows = cells
        for number, row in enumerate(rows, start=1):
            if len(row) != len(columns):
                raise InputError(
                    f"the history {path} has {len(row)} values in row {number} but "
                    f"{len(columns)} columns; was it edited?"
                )
        history = cls(None, MPI.COMM_SELF)
        history._columns = [column.removeprefix(MARK) for column in columns]
        history._rows = [{} for _ in rows]
        for index, column in enumerate(history._columns):
            values = _parsed([row[index] for row in rows])
            for target, value in zip(history._rows, values, strict=True):
                if value != "":
                    target[column] = value
        return history


def _name(column: object) -> str:
    if not isinstance(column, str) or not column or column != column.strip():
        raise InputError(f"{column!r} is not a column name; pass text without blanks around it.")
    return column


def _short(value: Value | None) -> str:
    """A value as shown in a notebook's table; "" for None."""
    if value is None:
        return ""
    return f"{value:.5g}" if isinstance(value, float) else escape(str(value))


def _plain(column: str, value: object) -> Value:
    if isinstance(value, str):
        return str(value)
    if isinstance(value, bool | np.bool_ | int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value)
    raise InputError(f"column {column!r} got {value!r}; pass an int, a float or text.")


def csv_line(values: Iterable[object]) -> str:
    """A row of a CSV file; numbers stay unchanged."""
    cells = (MARK + x if isinstance(x, str) and x.startswith(CALCULATED) else x for x in values)
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerow(cells)
    return buffer.getvalue()


def _parsed(texts: list[str]) -> list[Value]:
    for kind in (int, float):
        try:
            values: list[Value] = [kind(text) if text else "" for text in texts]
        except ValueError:
            continue
        if not any("_" in text for text in texts):  # Python reads "1_2" as 12
            return values
    return [text.removeprefix(MARK) for text in texts]
