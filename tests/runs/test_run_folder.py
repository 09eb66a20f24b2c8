"""What is written is what is read, with its units."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest
from small_run import COLUMNS, STEP, VEHICLES, append_chunk, chunk

from qrsim.errors import RunError, UsageError
from qrsim.runs import Column, Event, RunInfo, RunWriter, open_run

Start = Callable[..., RunWriter]


def test_arrays_come_back(start: Start) -> None:
    with start() as writer:
        append_chunk(writer, 1)
        writer.flush()
        append_chunk(writer, 5)
        append_chunk(writer, 9, count=1)
    run = open_run(writer.folder)
    assert run.vehicles == VEHICLES
    assert run.streams == ("truth", "measurements", "events")
    assert run.scenario_yaml == "name: two_fields\n"
    for stream, columns in COLUMNS.items():
        ticks, times, values = chunk(stream, 1, count=9)
        recorded = run[stream]
        assert np.array_equal(recorded.time, times)
        assert np.array_equal(recorded.tick, ticks)
        assert recorded.vehicles == VEHICLES
        assert recorded.columns() == tuple(column.name for column in columns)
        together = recorded.arrays()
        for column in columns:
            for array in (recorded[column.name], together[column.name]):
                assert array.dtype == column.dtype
                assert array.shape == (9, 3)
                assert np.array_equal(array, values[column.name])


def test_nan_and_jax_arrays_come_back(start: Start) -> None:
    ticks, times, values = chunk("measurements", 0)
    values["height"][2, 1] = np.nan
    with start() as writer:
        writer.append("measurements", jnp.asarray(ticks), times, {k: jnp.asarray(v) for k, v in values.items()})
    recorded = open_run(writer.folder)["measurements"]
    assert np.array_equal(recorded["height"], values["height"], equal_nan=True)
    assert np.isnan(recorded["height"]).sum() == 1


def test_the_arrays_may_be_reused_after_append(start: Start) -> None:
    ticks, times, values = chunk("truth", 0)
    expected = values["thrust"].copy()
    with start() as writer:
        writer.append("truth", ticks, times, values)
        for array in (ticks, times, *values.values()):
            array[:] = -1
    recorded = open_run(writer.folder)["truth"]
    assert np.array_equal(recorded["thrust"], expected)
    assert np.array_equal(recorded.tick, np.arange(4))


def test_units_docs_and_origin(start: Start) -> None:
    with start() as writer:
        append_chunk(writer, 0)
    run = open_run(writer.folder)
    assert run.units("truth") == {
        "time": "s",
        "tick": "",
        "vehicle": "",
        "position_ned.x": "m",
        "position_ned": "m",
        "thrust": "N",
    }
    assert run.describe("measurements")[3:] == COLUMNS["measurements"]
    assert run["truth"].column("thrust") == COLUMNS["truth"][2]
    # Any Parquet reader finds the same, in the file alone and in the folder.
    schema = pq.read_schema(writer.folder / "truth" / "part-00001.parquet")
    assert schema.field("thrust").metadata[b"unit"] == b"N"
    assert schema.field("thrust").metadata[b"doc"] == b"along the negative body z axis"
    assert schema.metadata[b"qrsim.scenario"] == b"two_fields"
    assert schema.metadata[b"qrsim.seed"] == b"7"
    assert schema.metadata[b"qrsim.version"].decode() == run.info.versions["qrsim"]
    assert pq.read_table(writer.folder / "truth").num_rows == 12


def test_table_is_long(start: Start) -> None:
    with start() as writer:
        append_chunk(writer, 0)
    run = open_run(writer.folder)
    table = run.table("truth")
    assert table.column_names == ["time", "tick", "vehicle", "position_ned.x", "position_ned", "thrust"]
    assert table["vehicle"].to_pylist() == list(VEHICLES) * 4
    assert table["tick"].to_pylist() == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]
    some = run.table("truth", ["position_ned", "time"])
    assert some.column_names == ["position_ned", "time"]
    assert some["position_ned"].to_pylist() == table["position_ned"].to_pylist()


def test_events(start: Start) -> None:
    first = Event(0.04, 2, "bravo", "limit", "position_ned.z", -3.5, "bravo left the flight area")
    second = Event(0.06, 3, None, "done", None, None, "")
    with start() as writer:
        assert open_run(writer.folder).events == []
        writer.append_event(0.04, 2, "bravo", "limit", "position_ned.z", -3.5, "bravo left the flight area")
        writer.flush()
        writer.append_event(0.06, 3, None, "done")
    run = open_run(writer.folder)
    assert run.events == [first, second]
    assert run.info.ticks == 3
    assert run.table("events").column_names == ["time", "tick", "vehicle", "kind", "field", "value", "message"]
    with pytest.raises(UsageError, match=r"use run.events"):
        run["events"]


def test_another_stream_in_place_of_the_events_is_told(start: Start) -> None:
    with start() as writer:
        append_chunk(writer, 1)
        writer.append_event(0.06, 3, None, "done")
    for part in (writer.folder / "events").iterdir():
        part.unlink()
    for part in (writer.folder / "truth").iterdir():
        (writer.folder / "events" / part.name).write_bytes(part.read_bytes())
    with pytest.raises(RunError, match=r"events: holds no events; its columns are time, .*; expected time, tick, veh"):
        _ = open_run(writer.folder).events


def test_run_info(start: Start) -> None:
    with start() as writer:
        assert open_run(writer.folder).info.state == "running"
        append_chunk(writer, 1)
        writer.flush()
        halfway = open_run(writer.folder).info
        assert (halfway.state, halfway.ticks, halfway.ended) == ("running", 4, None)
        append_chunk(writer, 5)
    info = open_run(writer.folder).info
    assert info == writer.info
    assert (info.state, info.ticks, info.message) == ("finished", 8, "")
    assert (info.scenario, info.seed, info.precision, info.time_step) == ("two_fields", 7, "float32", STEP)
    assert info.vehicles == VEHICLES
    assert info.command_line == "qrsim run 'two fields'"
    assert set(info.versions) == {"qrsim", "python", "jax", "numpy"}
    assert info.platform
    assert info.parts == {"truth": 3, "measurements": 3, "events": 1}
    assert info.ended is not None
    started, ended = datetime.fromisoformat(info.started), datetime.fromisoformat(info.ended)
    assert started.utcoffset() == ended.utcoffset() == timedelta(0)
    assert started <= ended


def test_flush_by_rows_and_by_time(start: Start, tmp_path: Path) -> None:
    # 12 rows per append of 4 ticks of 3 vehicles; the count is over all streams.
    by_rows = start(flush_rows=24)
    by_rows.append("truth", *chunk("truth", 0))
    assert len(open_run(by_rows.folder)["truth"].time) == 0
    by_rows.append("measurements", *chunk("measurements", 0))
    by_rows._finish_writing()
    assert len(open_run(by_rows.folder)["truth"].time) == 4
    by_time = start(folder=tmp_path / "other", flush_seconds=0.0)
    by_time.append("truth", *chunk("truth", 0))
    by_time._finish_writing()
    assert len(open_run(by_time.folder)["truth"].time) == 4


def test_a_stream_without_rows_still_has_columns(start: Start) -> None:
    with start() as writer:
        writer.append("truth", *chunk("truth", 0, count=0))
    run = open_run(writer.folder)
    assert run.units("measurements")["height"] == "m"
    assert run["measurements"]["height"].shape == (0, 3)
    assert run["truth"].time.shape == (0,)


def test_wrong_appends_name_the_fault_and_record_nothing(start: Start) -> None:
    ticks, times, values = chunk("truth", 0)
    with start() as writer:
        with pytest.raises(UsageError, match=r"no stream 'thruth'.*did you mean 'truth'"):
            writer.append("thruth", ticks, times, values)
        with pytest.raises(UsageError, match="no stream 'events'"):
            writer.append("events", ticks, times, values)
        with pytest.raises(UsageError, match="no column 'thrst' was declared; did you mean 'thrust'"):
            writer.append("truth", ticks, times, {**values, "thrst": values["thrust"]})
        with pytest.raises(UsageError, match="no values for position_ned, thrust"):
            writer.append("truth", ticks, times, {"position_ned.x": values["position_ned.x"]})
        with pytest.raises(UsageError, match=r"'thrust': shape \(3, 4\), expected shape \(4, 3\)"):
            writer.append("truth", ticks, times, {**values, "thrust": values["thrust"].T})
        with pytest.raises(UsageError, match=r"'time': shape \(3,\), expected shape \(4,\)"):
            writer.append("truth", ticks, times[:3], values)
        with pytest.raises(UsageError, match="'tick': declared as int64, got float64"):
            writer.append("truth", times, times, values)
        with pytest.raises(UsageError, match="no vehicle 'brava'; did you mean 'bravo'"):
            writer.append_event(0.0, 0, "brava", "limit")
    run = open_run(writer.folder)
    assert run["truth"].time.shape == (0,)
    with pytest.raises(RunError, match="is closed"):
        writer.append("truth", ticks, times, values)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"events": ()}, "'events' cannot name a stream"),
        ({"../truth": ()}, "cannot name a stream"),
        ({"truth": (Column("a"), Column("a"))}, "'a' is empty or used twice"),
        ({"truth": (Column("time"),)}, "'time' is empty or used twice"),
        ({"truth": (Column("a", dtype="complex128"),)}, "no dtype 'complex128'"),
        ({"truth": (Column("a", dtype="nonsense"),)}, "no dtype 'nonsense'"),
        ({"truth": (Column("a", dtype="str"),)}, "use an event"),
    ],
)
def test_wrong_declarations(
    tmp_path: Path, info: RunInfo, columns: dict[str, tuple[Column, ...]], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        RunWriter.create(tmp_path / "run", info=info, scenario_yaml="", columns=columns)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("vehicles", [(), ("a", "a")])
def test_vehicles_need_names_of_their_own(tmp_path: Path, info: RunInfo, vehicles: tuple[str, ...]) -> None:
    with pytest.raises(UsageError, match="vehicles of different names"):
        RunWriter.create(tmp_path / "run", info=replace(info, vehicles=vehicles), scenario_yaml="", columns=COLUMNS)


def test_a_vector_without_its_axis_names_its_columns(tmp_path: Path, info: RunInfo) -> None:
    wind = {"wind": tuple(Column(f"gust_ned.{axis}", "m/s", "", "float32") for axis in "xyz")}
    with RunWriter.create(tmp_path / "run", info=info, scenario_yaml="", columns=wind) as writer:
        values = np.zeros((1, len(info.vehicles)), np.float32)
        writer.append("wind", np.array([0]), np.array([0.0]), {f"gust_ned.{axis}": values for axis in "xyz"})
    expected = r"'wind' has no column 'gust_ned'; its columns are gust_ned\.x, gust_ned\.y, gust_ned\.z"
    with pytest.raises(UsageError, match=expected):
        open_run(tmp_path / "run")["wind"]["gust_ned"]


def test_reading_errors_name_the_nearest(start: Start, tmp_path: Path) -> None:
    with start() as writer:
        append_chunk(writer, 0)
    run = open_run(writer.folder)
    with pytest.raises(UsageError, match="no stream 'measurement'; did you mean 'measurements'"):
        run["measurement"]
    with pytest.raises(UsageError, match="no stream 'wind'; known: truth, measurements, events"):
        run.table("wind")
    with pytest.raises(UsageError, match="'truth' has no column 'trust'; did you mean 'thrust'"):
        run["truth"]["trust"]
    with pytest.raises(UsageError, match=r"no column 'position_ned\.z'; did you mean 'position_ned\.x'"):
        run.table("truth", ["position_ned.z"])
    with pytest.raises(UsageError, match="no such folder"):
        open_run(tmp_path / "absent")
    with pytest.raises(UsageError, match=r"not a run folder: it has no run\.json; runs inside it: run"):
        open_run(tmp_path)
    with pytest.raises(UsageError, match=r"not a run folder.*; the run is .*run$"):
        open_run(tmp_path / "run" / "truth")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": 2}, "has the run folder format 2; this version of qrsim reads format 1"),
        ({"state": "lost"}, "is damaged: state: "),
        ({"seed": None}, "is damaged: seed: "),
    ],
)
def test_a_damaged_run_file(start: Start, change: dict[str, object], message: str) -> None:
    with start() as writer:
        pass
    path = writer.folder / "run.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(RunError, match=message):
        open_run(writer.folder)
    path.write_text("{")
    with pytest.raises(RunError, match=r"run\.json is damaged"):
        open_run(writer.folder)
