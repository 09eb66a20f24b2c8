"""Whatever ends a run, what was flushed stays readable, and the folder says what happened."""

from __future__ import annotations

import _thread
import errno
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_run import COLUMNS, append_chunk, chunk

from qrsim.errors import RunError, UsageError
from qrsim.files import atomic
from qrsim.files.interruptions import Interruption, heard
from qrsim.runs import Run, RunInfo, RunWriter, open_run

Start = Callable[..., RunWriter]


def assert_recorded(run: Run, ticks: int) -> None:
    """Both streams hold ticks 0 ... ticks - 1 exactly, and nothing temporary lies about."""
    for stream in COLUMNS:
        expected_ticks, expected_times, values = chunk(stream, 0, count=ticks)
        assert np.array_equal(run[stream].tick, expected_ticks)
        assert np.array_equal(run[stream].time, expected_times)
        for name, array in run[stream].arrays().items():
            assert np.array_equal(array, values[name]), name


def end_by(writer: RunWriter, error: BaseException) -> None:
    """Append ticks 0 ... 3, then leave the run by this exception, which must come out unchanged."""

    def body() -> None:
        with writer:
            append_chunk(writer, 0)
            raise error

    with pytest.raises(type(error)) as caught:
        body()
    assert caught.value is error


def temporary_files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.name.startswith(".") or path.suffix == ".tmp"]


KILLED = """
import sys
import threading
sys.path.insert(0, sys.argv[2])
from small_run import COLUMNS, STEP, VEHICLES, append_chunk
from qrsim.runs import RunInfo, RunWriter
info = RunInfo.collect(scenario="killed", seed=1, precision="float64", time_step=STEP, vehicles=VEHICLES)
writer = RunWriter.create(sys.argv[1], info=info, scenario_yaml="a: 1", columns=COLUMNS,
                          flush_rows=10**9, flush_seconds=1e9)
append_chunk(writer, 0)
writer.flush()
append_chunk(writer, 4)
writer.flush()
append_chunk(writer, 8)
print("ready", flush=True)
i = 12
while sys.argv[3] == "flushing":
    append_chunk(writer, i, 400)
    writer.flush()
    i += 400
    if i == 1212:
        print("busy", flush=True)
sys.stdin.read()
"""


def killed_run(folder: Path, mode: str) -> Run:
    arguments = [sys.executable, "-c", KILLED, str(folder), str(Path(__file__).parent), mode]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(2 if mode == "flushing" else 1)]
        process.kill()
        assert process.wait(20) == -signal.SIGKILL
    assert lines == ["ready\n", "busy\n"][: len(lines)]
    return open_run(folder)


def test_killed_between_flushes(tmp_path: Path) -> None:
    run = killed_run(tmp_path / "run", "waiting")
    assert_recorded(run, 8)
    assert (run.info.state, run.info.ticks) == ("running", 7)


def test_killed_while_flushing(tmp_path: Path) -> None:
    # The kill falls anywhere in an endless row of flushes; what is there is whole parts, from the start on.
    run = killed_run(tmp_path / "run", "flushing")
    for stream in COLUMNS:
        recorded = run[stream]
        count = len(recorded.tick)
        assert count >= 1212
        assert (count - 12) % 400 == 0
        _, _, values = chunk(stream, 0, count)
        assert np.array_equal(recorded.tick, np.arange(count))
        for name, array in recorded.arrays().items():
            assert np.array_equal(array, values[name])


def test_temporary_files_are_ignored(start: Start) -> None:
    with start() as writer:
        append_chunk(writer, 0)
    (writer.folder / "truth" / ".part-00002.parquet.tmp").write_bytes(b"PAR1 half a part")
    (writer.folder / ".run.json.tmp").write_text("{")
    assert_recorded(open_run(writer.folder), 4)


def test_ctrl_c_keeps_what_was_buffered(start: Start) -> None:
    writer = start()
    end_by(writer, KeyboardInterrupt())
    run = open_run(writer.folder)
    assert_recorded(run, 4)
    assert (run.info.state, run.info.ticks) == ("interrupted", 3)
    assert run.info.ended is not None


def test_a_second_signal_does_not_keep_the_end_from_disk(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = start()
    plain = writer.close

    def pressed(*how: Any) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        for _ in range(1000):  # The handler runs between two instructions of Python.
            pass
        plain(*how)

    monkeypatch.setattr(writer, "close", pressed)
    with heard():
        end_by(writer, Interruption(signal.SIGINT))
    run = open_run(writer.folder)
    assert_recorded(run, 4)
    assert (run.info.state, run.info.message) == ("interrupted", "stopped by the user")


@pytest.mark.usefixtures("heeded")
@pytest.mark.parametrize("moment", ["fsync", "replace"])
def test_ctrl_c_in_the_middle_of_a_flush_neither_loses_nor_repeats_rows(
    start: Start, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    real = getattr(os, moment)
    calls = 0

    def interrupted(*arguments: object) -> None:
        nonlocal calls
        calls += 1
        real(*arguments)
        if calls == 2:  # after the second stream's bytes, or its new name, are on disk
            _thread.interrupt_main()

    writer = start()
    append_chunk(writer, 0)
    writer.flush()
    append_chunk(writer, 4)
    monkeypatch.setattr(atomic.os, moment, interrupted)
    with pytest.raises(KeyboardInterrupt), writer:
        writer.flush()
    assert calls > 2
    run = open_run(writer.folder)
    assert_recorded(run, 8)
    assert run.info.state == "interrupted"
    assert temporary_files(writer.folder) == []


def test_an_exception_is_recorded_as_the_reason(start: Start) -> None:
    writer = start()
    end_by(writer, ZeroDivisionError("no such luck"))
    run = open_run(writer.folder)
    assert_recorded(run, 4)
    assert (run.info.state, run.info.message) == ("failed", "ZeroDivisionError: no such luck")


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int], None]]:
    """Return a function after which the next ``allowed`` files are written and every later one finds no space."""
    real = os.fsync
    left: list[float] = [float("inf")]

    def fsync(descriptor: int) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(descriptor)

    monkeypatch.setattr(atomic.os, "fsync", fsync)

    def fill(allowed: int) -> None:
        left[0] = allowed

    yield fill
    left[0] = float("inf")


def test_disk_full_at_the_first_stream(start: Start, full_disk: Callable[[int], None]) -> None:
    writer = start()
    append_chunk(writer, 0)
    writer.flush()
    append_chunk(writer, 4)
    full_disk(0)
    message = r"^disk full while recording 'truth': the log up to t = 0\.06 s in .*run is readable$"
    with pytest.raises(RunError, match=message):
        writer.flush()
    run = open_run(writer.folder)
    assert_recorded(run, 4)
    # Not even run.json could be written: it still says what it said.
    assert (run.info.state, run.info.ticks) == ("running", 3)
    assert temporary_files(writer.folder) == []
    writer.close()  # a closed run: nothing happens, nothing is raised
    with pytest.raises(RunError, match="is closed"):
        append_chunk(writer, 8)


def test_disk_full_between_the_streams(start: Start, full_disk: Callable[[int], None]) -> None:
    writer = start()
    append_chunk(writer, 0)
    writer.flush()
    append_chunk(writer, 4)
    full_disk(1)
    with pytest.raises(RunError, match=r"disk full while recording 'measurements': the log up to t = 0\.06 s"):
        writer.flush()
    run = open_run(writer.folder)
    assert len(run["truth"].tick) == 8
    assert len(run["measurements"].tick) == 4


def test_disk_full_at_run_json_says_how_far_the_rows_go(start: Start, full_disk: Callable[[int], None]) -> None:
    writer = start()
    append_chunk(writer, 0)
    full_disk(2)
    with pytest.raises(RunError, match=r"disk full while updating run\.json: the log up to t = 0\.06 s"):
        writer.flush()
    assert_recorded(open_run(writer.folder), 4)


def test_disk_full_before_the_first_flush(start: Start, full_disk: Callable[[int], None]) -> None:
    writer = start()
    full_disk(0)
    with pytest.raises(RunError, match=r"disk full while recording 'truth': .* is readable, but empty"), writer:
        append_chunk(writer, 0)
    assert_recorded(open_run(writer.folder), 0)


def test_disk_full_after_another_error_keeps_that_error(start: Start, full_disk: Callable[[int], None]) -> None:
    error = ZeroDivisionError()
    writer = start()
    full_disk(0)
    end_by(writer, error)
    assert "disk full while recording 'truth'" in error.__notes__[0]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, a Linux device that is always full")
def test_a_really_full_device_marks_the_run_as_failed(start: Start) -> None:
    writer = start()
    append_chunk(writer, 0)
    writer.flush()
    # The next part's temporary name leads to the full device; run.json is on a disk with space.
    (writer.folder / "truth" / ".part-00002.parquet.tmp").symlink_to("/dev/full")
    with pytest.raises(RunError, match=r"disk full while recording 'truth': the log up to t = 0\.06 s"), writer:
        append_chunk(writer, 4)
    run = open_run(writer.folder)
    assert_recorded(run, 4)
    assert (run.info.state, run.info.ticks) == ("failed", 3)
    assert run.info.message.startswith("disk full while recording 'truth'")
    assert temporary_files(writer.folder) == []


def test_disk_full_while_creating_leaves_no_folder(
    start: Start, full_disk: Callable[[int], None], tmp_path: Path
) -> None:
    full_disk(2)
    with pytest.raises(RunError, match=r"cannot write in the run folder .*run: No space left on device"):
        start()
    assert list(tmp_path.iterdir()) == []


def test_another_write_error_says_which(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    def fsync(descriptor: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    writer = start()
    append_chunk(writer, 0)
    monkeypatch.setattr(atomic.os, "fsync", fsync)
    with pytest.raises(RunError, match=r"^cannot write \(Input/output error\) while recording 'truth'"):
        writer.flush()


def test_an_existing_folder_is_never_touched(start: Start, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match=r"run exists already, .* choose another folder with --out"):
        start()
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["notes.txt"]
    with pytest.raises(UsageError, match="exists already"):
        start(folder=tmp_path / "run" / "notes.txt")


def test_a_parent_that_is_a_file(start: Start, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match=r"cannot create the run folder .*: Not a directory"):
        start(folder=tmp_path / "file" / "run")


def test_a_parent_without_permission(start: Start, tmp_path: Path) -> None:
    parent = tmp_path / "locked"
    parent.mkdir(mode=0o500)
    is_root = os.geteuid() == 0
    if is_root:  # whom no mode stops
        os.seteuid(65534)
    try:
        with pytest.raises(RunError, match=r"cannot create the run folder .*: Permission denied"):
            start(folder=parent / "run")
    finally:
        if is_root:
            os.seteuid(0)


def test_missing_parents_are_made(start: Start, tmp_path: Path) -> None:
    with start(folder=tmp_path / "a" / "b" / "run") as writer:
        append_chunk(writer, 0)
    assert_recorded(open_run(tmp_path / "a" / "b" / "run"), 4)


@pytest.fixture
def three_parts(start: Start) -> Path:
    with start() as writer:
        for first in (0, 4, 8):
            append_chunk(writer, first)
            writer.flush()
    return writer.folder


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


def flip_a_value(path: Path) -> None:
    # One bit of a thrust: the file stays well formed, so that only its checksum can tell.
    data = bytearray(path.read_bytes())
    value = np.float32(4 * 10.0 + 2000).tobytes()
    assert data.count(value) >= 1
    data[data.index(value)] ^= 1
    path.write_bytes(bytes(data))


@pytest.mark.parametrize("damage", [truncate, flip_a_value, lambda path: path.write_bytes(b""), Path.unlink])
def test_a_damaged_part_is_named_and_never_skipped_silently(three_parts: Path, damage: Callable[[Path], None]) -> None:
    damage(three_parts / "truth" / "part-00002.parquet")
    run = open_run(three_parts)
    message = r"truth/part-00002\.parquet \(part 3 of 4 of 'truth'\) cannot be read: "
    with pytest.raises(RunError, match=message) as caught:
        run["truth"]["thrust"]
    # Of use in Python; a command prints the message without its notes.
    assert "skip_damaged" not in str(caught.value)
    assert caught.value.__notes__ == ["open_run(..., skip_damaged=True) reads the others"]
    with pytest.raises(RunError, match=message):
        run.table("truth")
    assert len(run["measurements"].tick) == 12

    rest = open_run(three_parts, skip_damaged=True)["truth"]
    with pytest.warns(UserWarning, match=r"left out: .*part-00002\.parquet"):
        ticks = rest.tick
    assert ticks.tolist() == [0, 1, 2, 3, 8, 9, 10, 11]
    assert np.array_equal(rest["thrust"], np.delete(chunk("truth", 0, 12)[2]["thrust"], slice(4, 8), axis=0))
    assert rest["position_ned"].shape == (8, 3)


def test_a_missing_last_part_is_noticed(three_parts: Path) -> None:
    (three_parts / "truth" / "part-00003.parquet").unlink()
    with pytest.raises(RunError, match=r"part-00003\.parquet \(part 4 of 4 of 'truth'\) cannot be read: it is missing"):
        open_run(three_parts).table("truth")


def test_a_part_of_another_stream_is_refused(three_parts: Path) -> None:
    (three_parts / "measurements" / "part-00001.parquet").replace(three_parts / "truth" / "part-00001.parquet")
    with pytest.raises(RunError, match="its columns are not those of the parts before it"):
        open_run(three_parts)["truth"].time  # noqa: B018


def test_no_part_left(three_parts: Path) -> None:
    for path in (three_parts / "truth").iterdir():
        path.unlink()
    with pytest.warns(UserWarning, match="it is missing"), pytest.raises(RunError, match="no part can be read"):
        open_run(three_parts, skip_damaged=True).units("truth")


def test_rows_that_are_no_grid_have_no_arrays(three_parts: Path, tmp_path: Path, info: RunInfo) -> None:
    path = three_parts / "run.json"
    path.write_text(path.read_text().replace('"charlie"', '"delta"'))
    run = open_run(three_parts)
    with pytest.raises(RunError, match="not one per vehicle at each tick"):
        run["truth"]["thrust"]
    assert run.table("truth").num_rows == 36


def test_a_flight_waits_for_a_disk_that_is_slower_than_it(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk takes nothing for now: one batch is with it, the next one is full, and no third one begins."""
    writer, disk, appended = start(flush_rows=24), threading.Event(), []
    plain = writer._write

    def slow(batch: Any) -> None:
        assert disk.wait(30.0)
        plain(batch)

    monkeypatch.setattr(writer, "_write", slow)

    def fly() -> None:
        with writer:
            for number in range(10):
                # A batch: two streams, three vehicles and four ticks.
                append_chunk(writer, 4 * number)
                appended.append(number)

    flight = threading.Thread(target=fly)
    flight.start()
    flight.join(0.3)
    assert flight.is_alive()
    assert len(appended) <= 2
    assert max(len(buffer.pending) for buffer in writer._buffers.values()) <= 2
    disk.set()
    flight.join(30.0)
    assert_recorded(open_run(writer.folder), 40)
