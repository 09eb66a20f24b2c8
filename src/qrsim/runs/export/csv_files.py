"""csv: one table per stream, for spreadsheets, pandas, R and MATLAB."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv

from qrsim.runs import Run
from qrsim.runs.export.output import Written, replacing
from qrsim.runs.layout import EVENTS


def write_stream(run: Run, stream: str, path: Path, every: int) -> Written:
    """Write a stream to a CSV file: one row per vehicle at every ``every``-th tick, or one row for each event.

    The header says ``name [unit]``. Numbers have all their digits: read back, they are the same. "nan" is a value
    that is not there at that time, an empty field one that the event does not have.

    Args:
        run: the run.
        stream: its name.
        path: file to write.
        every: rows are kept at the ticks that it divides; those of events all.

    Raises:
        RunError: the file cannot be written.
    """
    names = [f"{column.name} [{column.unit}]" if column.unit else column.name for column in run.describe(stream)]
    rows = 0
    with replacing(path) as file:
        writer = None
        for part in run.batches(stream):
            table = _plain(part if stream == EVENTS else _thinned(part, every)).rename_columns(names)
            # The first part is there in every run, if only with its columns.
            writer = writer or pacsv.CSVWriter(file, table.schema)
            writer.write_table(table)
            rows += table.num_rows
        if writer:
            writer.close()
    return Written(path, {"rows": rows})


def _thinned(table: pa.Table, every: int) -> pa.Table:
    """Return the rows of a table at ticks that ``every`` divides."""
    ticks = table["tick"].to_numpy()
    return table.filter(pa.array(ticks % every == 0))


def _plain(table: pa.Table) -> pa.Table:
    """Return an Arrow table with dictionary-encoded columns as plain text."""
    for i, item in enumerate(table.schema):
        if pa.types.is_dictionary(item.type):
            table = table.set_column(i, item.name, pc.cast(table[item.name], pa.string()))
    return table
