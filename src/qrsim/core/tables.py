"""Tables of numbers with their units, as text and for notebooks."""

from __future__ import annotations

import dataclasses
import html
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.core.tree import field_info
from qrsim.errors import QrsimError

# Columns of vehicles, rows, and numbers of one cell that are shown.
MOST_COLUMNS, MOST_ROWS, MOST_NUMBERS = 4, 60, 4
# Characters of a cell.
WIDEST = 100


@dataclass(frozen=True)
class Table:
    """A table with a title.

    Attributes:
        title: one line.
        headings: of the columns.
        rows: cells, as many as there are headings.
        widest: characters of a cell; longer ones are cut.
    """

    title: str
    headings: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    widest: int = WIDEST

    def _shown(self) -> list[tuple[str, ...]]:
        """Return the rows that are printed, cut to the largest length and width; the last counts those left out."""
        rows = [tuple(_shortened(cell, self.widest) for cell in row) for row in self.rows[:MOST_ROWS]]
        left = len(self.rows) - len(rows)
        return rows + ([(f"and {left} more", *[""] * (len(self.headings) - 1))] if left else [])

    def text(self) -> str:
        """Return the table as lines of text, columns aligned."""
        rows = self._shown()
        if not rows:
            return self.title
        every = [self.headings, *rows]
        widths = [max(len(row[column]) for row in every) for column in range(len(self.headings))]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in every]
        return "\n".join([self.title, *(f"  {line}".rstrip() for line in lines)])

    def html(self) -> str:
        """Return the table as an HTML element, for notebooks."""
        head = "".join(f"<th>{html.escape(heading)}</th>" for heading in self.headings)
        body = "".join(f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in self._shown())
        caption = f"<caption>{html.escape(self.title)}</caption>"
        return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


class Tabled:
    """Base of objects that a prompt and a notebook show as a table.

    A dataclass names ``__repr__ = Tabled.__repr__`` itself, or it gets one of its own.
    """

    def _table(self) -> Table:
        """Return the table that represents the object; subclasses must define it."""
        raise NotImplementedError

    def _table_or_fault(self) -> Table:
        """Return the object's table, or an empty one titled with the error that prevents it."""
        try:
            return self._table()
        except QrsimError as error:
            return Table(f"<{type(self).__name__} that cannot be shown: {error}>", (), ())

    def __repr__(self) -> str:
        return self._table_or_fault().text()

    def _repr_html_(self) -> str:
        """Return the object's table as HTML, as Jupyter notebooks show it."""
        return self._table_or_fault().html()


def number_text(value: object, digits: int = 4) -> str:
    """Return the first numbers of a value as text; dtype and shape for a traced array, "" for None."""
    if value is None:
        return ""
    if isinstance(value, jax.core.Tracer):
        return f"{value.dtype}{list(value.shape)}"
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        return str(value)
    flat = array.reshape(-1)
    texts = [str(one) if array.dtype.kind in "iub" else f"{one:.{digits}g}" for one in flat[:MOST_NUMBERS].tolist()]
    more = [f"... ({flat.size})"] if flat.size > MOST_NUMBERS else []
    return ", ".join([*texts, *more])


def cells_of(array: NumpyArray | jax.Array, columns: int, digits: int = 4) -> tuple[str, ...]:
    """Return one text for each table column: the first rows of an array (n, ...), then "..." if rows are left out."""
    if isinstance(array, jax.core.Tracer):
        return (number_text(array), *[""] * (columns - 1))
    cells = [number_text(row, digits) for row in array[: min(columns, MOST_COLUMNS)]]
    return (*cells, *["..."] * (columns - len(cells)))[:columns]


def parameters_text(part: object) -> str:
    """Return a component's scalar parameters as one text, "name value unit, ..."."""
    if not dataclasses.is_dataclass(part):
        return ""
    texts = []
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        info = field_info(field)
        plain = isinstance(value, str | bool | int | float)
        if plain or (isinstance(value, np.ndarray | np.generic | jax.Array) and np.shape(value) == ()):
            unit = info.unit if info.unit not in ("", "1") and not isinstance(value, str) else ""
            texts.append(f"{field.name} {number_text(value)}{' ' * bool(unit)}{unit}")
    return ", ".join(texts)


def columns_of(names: Sequence[str]) -> tuple[str, ...]:
    """Return the headings of a table's vehicle columns: the first names, then the total if names are left out."""
    if len(names) <= MOST_COLUMNS:
        return tuple(names)
    return (*names[:MOST_COLUMNS], f"({len(names)} in all)")


def _shortened(cell: str, widest: int) -> str:
    """Return a table cell on one line, cut to at most ``widest`` characters."""
    line = " ".join(cell.split())
    return line if len(line) <= widest else line[: widest - 3] + "..."
