"""A stream read piece by piece is the stream read at once."""

from __future__ import annotations

from collections.abc import Callable

import pyarrow as pa
import pytest
from small_run import append_chunk

from qrsim.errors import RunError, UsageError
from qrsim.logs import RunWriter, open_run


def test_the_pieces_make_up_the_table(start: Callable[..., RunWriter]) -> None:
    with start() as writer:
        for first_tick in (1, 5, 9):
            append_chunk(writer, first_tick)
            writer.flush()
    run = open_run(writer.folder)
    pieces = list(run.batches("truth"))
    # The first part is empty: it holds the columns.
    assert [piece.num_rows for piece in pieces] == [0, 12, 12, 12]
    assert pa.concat_tables(pieces).equals(run.table("truth"))
    some = pa.concat_tables(run.batches("truth", ["thrust", "tick"]))
    assert some.equals(run.table("truth", ["thrust", "tick"]))


def test_only_the_piece_asked_for_is_read(start: Callable[..., RunWriter]) -> None:
    with start() as writer:
        for first_tick in (1, 5):
            append_chunk(writer, first_tick)
            writer.flush()
    (writer.folder / "truth" / "part-00002.parquet").write_bytes(b"")
    pieces = open_run(writer.folder).batches("truth")
    assert [next(pieces).num_rows for _ in range(2)] == [0, 12]
    with pytest.raises(RunError, match=r"truth/part-00002\.parquet"):
        next(pieces)


def test_wrong_names_are_refused_before_anything_is_read(start: Callable[..., RunWriter]) -> None:
    with start() as writer:
        append_chunk(writer, 1)
    run = open_run(writer.folder)
    with pytest.raises(UsageError, match="did you mean 'truth'"):
        run.batches("trut")
    with pytest.raises(UsageError, match="did you mean 'thrust'"):
        run.batches("truth", ["trust"])
