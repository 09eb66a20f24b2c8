"""A stream read piece by piece is the stream read at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pyarrow as pa
import pytest
from small_run import append_chunk

from qrsim.errors import RunError, UsageError
from qrsim.runs import RunWriter, open_run
from qrsim.runs.parts import StreamParts


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


def test_arrays_piece_by_piece(start: Callable[..., RunWriter]) -> None:
    with start() as writer:
        for first_tick in (1, 5, 9):
            append_chunk(writer, first_tick)
            writer.flush()
    stream = open_run(writer.folder)["truth"]
    pieces = list(stream.batches(["thrust"]))
    # Nothing of the empty first part.
    assert [piece.tick.tolist() for piece in pieces] == [[1, 2, 3, 4], [5, 6, 7, 8], [9, 10, 11, 12]]
    np.testing.assert_array_equal(np.concatenate([piece.time for piece in pieces]), stream.time)
    joined = np.concatenate([piece.arrays["thrust"] for piece in pieces])
    np.testing.assert_array_equal(joined, stream["thrust"])
    assert joined.dtype == np.float32
    with pytest.raises(UsageError, match="has no column 'trust'; did you mean 'thrust'"):
        next(stream.batches(["trust"]))


def test_pieces_after_the_times_are_known_read_no_times(
    start: Callable[..., RunWriter], monkeypatch: pytest.MonkeyPatch
) -> None:
    with start() as writer:
        for first_tick in (1, 5):
            append_chunk(writer, first_tick)
            writer.flush()
    stream, read = open_run(writer.folder)["truth"], []
    assert stream.time.tolist() == pytest.approx([0.02, 0.04, 0.06, 0.08, 0.10, 0.12, 0.14, 0.16])
    plain = StreamParts._read_part
    monkeypatch.setattr(StreamParts, "_read_part", lambda self, *rest: (read.append(rest[2]), plain(self, *rest))[1])
    pieces = list(stream.batches(["thrust"]))
    assert read == [["thrust"]] * 3
    assert [piece.tick.tolist() for piece in pieces] == [[1, 2, 3, 4], [5, 6, 7, 8]]
    assert [piece.time.tolist() for piece in pieces] == [stream.time[:4].tolist(), stream.time[4:].tolist()]
    # Ten a tick, one a vehicle, and 2000 of the third column.
    assert pieces[1].arrays["thrust"][0].tolist() == [2050.0, 2051.0, 2052.0]
    empty, last = (writer.folder / "truth" / f"part-0000{number}.parquet" for number in (0, 2))
    last.write_bytes(empty.read_bytes())
    with pytest.raises(RunError, match=r"truth: its files have changed since they were opened"):
        list(stream.batches(["thrust"]))


def test_pieces_of_other_times_are_not_read(start: Callable[..., RunWriter], monkeypatch: pytest.MonkeyPatch) -> None:
    """Of forty pieces only a few are opened, to find those of a time."""
    with start() as writer:
        for first_tick in range(1, 161, 4):
            append_chunk(writer, first_tick)
            writer.flush()
    stream = open_run(writer.folder)["truth"]
    time, opened = stream.time, []
    plain = StreamParts._read_part
    monkeypatch.setattr(StreamParts, "_read_part", lambda self, *rest: (opened.append(rest[0]), plain(self, *rest))[1])
    # Ticks 78 to 82 are in the pieces of 77 to 80 and of 81 to 84.
    pieces = list(stream.batches(["thrust"], start=time[77], end=time[81]))
    assert [piece.tick.tolist() for piece in pieces] == [[77, 78, 79, 80], [81, 82, 83, 84]]
    assert len(set(opened)) <= 9
    assert len(list(stream.batches(["thrust"], end=time[3]))) == 1
    assert list(stream.batches(["thrust"], start=time[-1] + 1.0)) == []
    assert len(list(stream.batches(["thrust"]))) == 40


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
