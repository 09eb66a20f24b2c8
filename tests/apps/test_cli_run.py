"""``qrsim run``: exit codes, table, JSON, run folder, and what is left after every way to end."""

from __future__ import annotations

import contextlib
import errno
import io
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from tests.interrupting import INTERRUPTIBLE

from qrsim import cli
from qrsim.apps import seconds_of
from qrsim.apps.run import command
from qrsim.engine import programs
from qrsim.engine.llvm import program
from qrsim.files import atomic
from qrsim.runs import open_run, recorder
from qrsim.runs.summary import summarise
from qrsim.scenarios.scenario import load_scenario

STREAMS = ("truth", "measurements", "commands", "wind")
TICKS, VEHICLES = 500, 5
FIX_TICKS = 10  # the receiver's 0.2 s in steps of 0.02 s
HEADINGS = (
    "vehicle",
    "flown",
    "tracking",
    "GNSS",
    "wind max",
    "points",
    "stopped",
    " [m]",
    "RMS [m]",
    "hor. [m]",
    "vert. [m]",
    "[m/s]",
    "at [s]",
)
LONG_NAME = "a[m] name that is far longer than anybody would choose"


def columns(folder: Path, stream: str, *names: str) -> np.ndarray:
    """Read columns with pyarrow alone: (len(names), T, n)."""
    table = pq.read_table(folder / stream, columns=list(names))
    return np.stack([table[name].to_numpy() for name in names]).reshape(len(names), -1, VEHICLES).astype(np.float64)


def vector(folder: Path, stream: str, name: str) -> np.ndarray:
    return columns(folder, stream, *(f"{name}.{axis}" for axis in "xyz"))


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(values**2, axis=0))


def from_leg(place: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """Distance of a point from the line between two others."""
    leg = end - start
    if not leg.any():
        return float(np.linalg.norm(place - start))
    share = min(1.0, max(0.0, np.dot(place - start, leg) / np.dot(leg, leg)))
    return float(np.linalg.norm(place - (start + share * leg)))


# ---------------------------------------------------------------- what a run leaves


def test_the_run_is_fine_and_says_nothing_else(flown):
    assert (flown.code, flown.complaints) == (0, "")
    assert sorted(path.name for path in flown.folder.iterdir()) == sorted(
        [*STREAMS, "events", "figure.png", "run.json", "scenario.yaml"]
    )
    assert not list(flown.folder.rglob("*.tmp"))


def test_every_tick_of_every_vehicle_is_there(flown):
    run = open_run(flown.folder)
    assert (run.info.state, run.info.ticks, run.info.seed, run.info.precision) == ("finished", TICKS, 3, "float32")
    assert run.vehicles == tuple(f"pelicans_{i}" for i in range(VEHICLES))
    for stream in STREAMS:
        np.testing.assert_array_equal(run[stream].tick, np.arange(TICKS + 1))
        np.testing.assert_allclose(run[stream].time, 0.02 * np.arange(TICKS + 1), rtol=0, atol=1e-12)
        for name, array in run[stream].arrays().items():
            assert array.shape == (TICKS + 1, VEHICLES)
            assert np.isfinite(array.astype(float)).all(), name


def test_tick_0_is_the_start_of_the_scenario(flown):
    spec = load_scenario("outdoor_patrol").spec
    starts = [vehicle.position_ned for vehicle in spec.fleets["pelicans"].vehicles]
    np.testing.assert_array_equal(vector(flown.folder, "truth", "position_ned")[:, 0].T, starts)


def test_every_column_has_a_unit_and_a_meaning(flown):
    units = {}
    for stream in STREAMS:
        for part in sorted((flown.folder / stream).iterdir()):
            for field in pq.read_schema(part):
                assert set(field.metadata) == {b"unit", b"doc"}
                assert field.metadata[b"doc"]
                units[f"{stream}.{field.name}"] = field.metadata[b"unit"].decode()
    expected = {
        "truth.time": "s",
        "truth.position_ned.z": "m",
        "truth.attitude.pitch": "rad",
        "truth.velocity_body.x": "m/s",
        "truth.rates_body.y": "rad/s",
        "truth.thrust": "N",
        "truth.specific_force.z": "m/s^2",
        "measurements.gnss.position_ned.x": "m",
        "measurements.barometer.height_rate": "m/s",
        "commands.battery": "V",
        "commands.setpoint.yaw": "rad",
        "wind.gust_ned.y": "m/s",
    }
    assert {name: units[name] for name in expected} == expected
    # Only counts, flags and names may have no unit.
    bare = {name.rsplit(".", 1)[1] for name, unit in units.items() if not unit}
    assert bare == {"tick", "vehicle", "valid", "clipped", "waypoint"}


def test_json_says_what_was_flown(flown):
    result = flown.json
    assert {key: result[key] for key in ("scenario", "seed", "precision", "simulated_s", "overruns")} == {
        "scenario": "outdoor_patrol",
        "seed": 3,
        "precision": "float32",
        "simulated_s": 10.0,
        "overruns": 0,
    }
    assert result["run"] == str(flown.folder)
    assert result["figure"] == str(flown.folder / "figure.png")
    assert result["wall_s"] > 0
    assert result["start_up_s"] > 0
    assert 0.0 < time.time() - result["first_tick_unix_s"] < 3600.0
    assert result["real_time_factor"] > 0
    assert [vehicle["vehicle"] for vehicle in result["vehicles"]] == [f"pelicans_{i}" for i in range(VEHICLES)]
    assert {vehicle["stopped"] for vehicle in result["vehicles"]} == {""}


def test_json_agrees_with_the_log(flown):
    """Every number is computed again here, from the Parquet files and the definitions alone."""
    folder, vehicles = flown.folder, flown.json["vehicles"]

    def said(key: str) -> list[Any]:
        return [vehicle[key] for vehicle in vehicles]

    position = vector(folder, "truth", "position_ned")
    steps = np.linalg.norm(position[:, 1:] - position[:, :-1], axis=0)
    np.testing.assert_allclose(said("distance_m"), steps.sum(axis=0), rtol=1e-9)

    reported = vector(folder, "measurements", "gnss.position_ned")
    # The receiver's delay is one period: the fix of tick 0 is still the newest at tick 10, and counts once.
    np.testing.assert_array_equal(reported[:, FIX_TICKS], reported[:, 0])
    fixes = np.arange(0, TICKS + 1, FIX_TICKS)
    error = reported[:, fixes[1:]] - position[:, fixes[:-1]]
    np.testing.assert_allclose(said("gnss_horizontal_rms_m"), rms(np.hypot(error[0], error[1])), rtol=1e-9)
    np.testing.assert_allclose(said("gnss_vertical_rms_m"), rms(error[2]), rtol=1e-9)

    wind = vector(folder, "wind", "mean_ned") + vector(folder, "wind", "gust_ned")
    np.testing.assert_allclose(said("worst_wind_m_s"), np.linalg.norm(wind, axis=0).max(axis=0), rtol=1e-9)

    target = vector(folder, "commands", "setpoint.position_ned")
    distances = np.empty((TICKS + 1, VEHICLES))
    legs = np.zeros(VEHICLES, int)
    for vehicle in range(VEHICLES):
        start, end = position[:, 0, vehicle], target[:, 0, vehicle]
        for tick in range(TICKS + 1):
            if (target[:, tick, vehicle] != end).any():
                start, end = end, target[:, tick, vehicle]
                legs[vehicle] += 1
            distances[tick, vehicle] = from_leg(position[:, tick, vehicle], start, end)
    np.testing.assert_allclose(said("tracking_error_rms_m"), rms(distances), rtol=1e-9)
    np.testing.assert_allclose(said("height_error_rms_m"), rms((position - target)[2]), rtol=1e-9)
    assert said("charge_least") == [None] * VEHICLES
    # Each waypoint reached brings the next set-point, and the test would be empty without one.
    assert said("waypoints") == legs.tolist()
    assert legs.sum() > 0


def test_json_has_the_events_of_the_log(flown):
    rows = pq.read_table(flown.folder / "events").to_pylist()
    assert flown.json["events"] == rows
    assert {row["kind"] for row in rows} == {"waypoint_reached"}
    assert [row["time"] for row in rows] == sorted(row["time"] for row in rows)


def test_the_table_has_the_numbers_of_the_json(flown, flown_again):
    assert flown_again.code == 0
    lines = flown_again.printed.splitlines()
    assert lines[0] == "outdoor_patrol, seed 3"
    for vehicle in flown.json["vehicles"]:
        [cells] = [line.split() for line in lines if line.startswith(f"{vehicle['vehicle']} ")]
        assert cells[1:] == [
            f"{vehicle['distance_m']:.1f}",
            f"{vehicle['tracking_error_rms_m']:.2f}",
            f"{vehicle['gnss_horizontal_rms_m']:.2f}",
            f"{vehicle['gnss_vertical_rms_m']:.2f}",
            f"{vehicle['worst_wind_m_s']:.1f}",
            f"{vehicle['waypoints']}",
            "-",
        ]
    worst = max(flown.json["vehicles"], key=lambda vehicle: vehicle["height_error_rms_m"])
    height, of = f"{worst['height_error_rms_m']:.2f}", worst["vehicle"]
    assert f"height: RMS {height} m from that of the waypoint, at most, of {of}" in lines
    assert f"run folder: {flown_again.folder}" in lines
    nearest = flown.json["separation"]
    one, other = nearest["vehicles"]
    told = f"separation: {nearest['distance_m']:.2f} m at least, of {one} and {other} at {nearest['time_s']:.2f} s"
    assert told in lines
    assert any(re.fullmatch(r"10 s flown in \S+ s \(\d+ times real time\), start-up \S+ s", line) for line in lines)
    assert "figure" not in flown_again.printed
    assert not (flown_again.folder / "figure.png").exists()


@pytest.mark.parametrize("columns", [80, 200])
def test_the_table_fits_into_the_terminal(flown, monkeypatch, capsys, columns):
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes the output for a terminal
    monkeypatch.setenv("COLUMNS", str(columns))
    table = table_with_a_long_name(flown, capsys)
    assert max(map(len, table)) <= columns
    headings = "\n".join(table[2:4])
    for heading in HEADINGS:
        assert heading in headings
    # In 80 columns the name is folded, and all of it is there.
    rows = table[5 : 5 + (5 if columns == 80 else 1)]
    width = table[3].index("[m]") - 4
    assert "".join(line[:width].replace(" ", "") for line in rows).startswith(LONG_NAME.replace(" ", ""))


def test_the_table_is_not_folded_in_a_file(flown, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "60")
    assert any(line.startswith(f"{LONG_NAME} ") for line in table_with_a_long_name(flown, capsys))


class GoneReader(io.StringIO):
    """What ``| head -2`` leaves: two lines are read, and the table under them finds nobody."""

    def write(self, text: str) -> int:
        if text and self.getvalue().count("\n") >= 2:
            raise BrokenPipeError
        return super().write(text)


def test_a_reader_that_goes_away_in_the_middle_of_the_table(tmp_path):
    words = ["run", "--duration", "0.02", "--no-figure", "--out", str(tmp_path / "run")]
    with contextlib.redirect_stdout(GoneReader()) as output:
        assert cli.main(words) == 141
    assert output.getvalue() == "outdoor_patrol, seed 0\n\n"


def table_with_a_long_name(flown: Any, capsys: pytest.CaptureFixture[str]) -> list[str]:
    run = open_run(flown.folder)
    first, *others = summarise(run)
    command._print_table(run, [replace(first, vehicle=LONG_NAME), *others])
    return re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out).split("tracking:")[0].splitlines()


def test_the_resolved_scenario_is_the_same_run_bit_for_bit(flown, flown_again):
    first, second = open_run(flown.folder), open_run(flown_again.folder)
    assert first.scenario_yaml == second.scenario_yaml
    assert yaml.safe_load(first.scenario_yaml)["duration"] == 10.0
    for stream in (*STREAMS, "events"):
        assert first.table(stream).equals(second.table(stream)), stream


def test_another_seed_is_another_run_from_the_same_start(flown, fly):
    other = fly("--seed", "4", "--duration", "0.2", "--no-figure")
    here, there = (vector(f.folder, "measurements", "gnss.position_ned")[:, 0] for f in (flown, other))
    assert not np.isclose(here, there).any()
    here, there = (vector(f.folder, "truth", "position_ned")[:, 0] for f in (flown, other))
    np.testing.assert_array_equal(here, there)


def test_overrides_are_in_the_resolved_scenario(fly):
    words = ("--set", "world.wind.speed_20ft=0", "--set", "site.height=12.5")
    flight = fly("--duration", "0.02", "--no-figure", "--json", *words)
    resolved = yaml.safe_load((flight.folder / "scenario.yaml").read_text())
    assert resolved["world"]["wind"]["speed_20ft"] == 0.0
    assert resolved["site"]["height"] == 12.5
    assert not vector(flight.folder, "wind", "mean_ned").any()


def test_the_run_folder_says_which_compiler_flew(flown):
    info = open_run(flown.folder).info
    assert (info.compiler, info.compiler_refused) == ("llvm", "")


@pytest.mark.long
@pytest.mark.filterwarnings("default::qrsim.errors.CompilerWarning")
def test_the_run_folder_says_why_it_was_xla(fly, monkeypatch):
    """Where machine code fails, and where XLA was asked for."""

    def fails(text, tier):
        raise RuntimeError("a fault for a test")

    monkeypatch.setenv("QRSIM_COMPILATION_CACHE", "off")
    monkeypatch.setattr(program, "machine_code", fails)
    programs.forget()
    refused = fly("hover_ideal", "--duration", "0.02", "--no-figure")
    assert refused.complaints.count("a fault for a test") == 1
    monkeypatch.setenv("QRSIM_COMPILER", "xla")
    wanted = fly("hover_ideal", "--duration", "0.02", "--no-figure")
    programs.forget()
    written = [json.loads((flight.folder / "run.json").read_text()) for flight in (refused, wanted)]
    assert [run["compiler"] for run in written] == ["xla", "xla"]
    assert "an error of the code generator itself (RuntimeError: a fault for a test)" in written[0]["compiler_refused"]
    assert written[1]["compiler_refused"] == ""


def test_at_exit_no_garbage_is_looked_for():
    """To search all that JAX has made takes as long as half of its import."""
    words = (
        "import sys; sys.argv = ['qrsim']\nimport qrsim.cli\n"
        "class Ring:\n    def __del__(self): print('searched')\nring = Ring(); ring.self = ring"
    )
    told = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)
    assert (told.stdout, told.stderr) == ("", "")


def test_without_out_the_folders_are_numbered(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        assert cli.main(["run", "--seed", "9", "--duration", "0.02", "--no-figure"]) == 0
    found = sorted(path.name for path in (tmp_path / "runs").iterdir())
    assert len(found) == 2
    assert all(re.fullmatch(r"outdoor_patrol-seed9-\d{8}-\d{6}(-2)?", name) for name in found)
    printed = capsys.readouterr().out
    assert all(f"run folder: runs/{name}\n" in printed for name in found)


# ---------------------------------------------------------------- vehicles that stop


@pytest.fixture(scope="module")
def crashed(fly):
    """The lowest vehicle starts at 20 m, sinks a little under the published controller, and meets a floor at 19.5 m."""
    published = "fleets.pelicans.controller={type: waypoint, tilt_limit: 0.6}"
    return fly("--duration", "10", "--no-figure", "--set", "world.area.z_max=-19.5", "--set", published)


def test_a_crash_is_in_the_table_and_in_the_events(crashed):
    assert (crashed.code, crashed.complaints) == (0, "")
    run = open_run(crashed.folder)
    [event] = [event for event in run.events if event.kind == "out_of_area"]
    assert (event.vehicle, event.field, run.info.state) == ("pelicans_0", "position_ned.z", "finished")
    assert event.value > -19.5
    assert (
        event.message == f"pelicans_0 stopped at {event.time:.2f} s, out_of_area: position_ned.z = {event.value:.4g} m"
    )
    lines = crashed.printed.splitlines()
    assert event.message in lines
    stopped = {line.split()[0]: line.split()[-1] for line in lines if line.startswith("pelicans_") and line[10] == " "}
    del stopped["pelicans_0"]
    table = [line for line in lines if line.startswith("pelicans_0 ") and line != event.message]
    assert [line.split()[-1] for line in table] == [f"{event.time:.2f}"]
    assert set(stopped.values()) == {"-"}


def test_a_crashed_vehicle_stays_and_its_sensors_say_nothing(crashed):
    run = open_run(crashed.folder)
    valid = run["truth"]["valid"]
    tick = int(np.argmin(valid[:, 0]))
    assert 0 < tick < TICKS
    assert not valid[tick:, 0].any()
    assert valid[:, 1:].all()
    position = vector(crashed.folder, "truth", "position_ned")
    np.testing.assert_array_equal(position[:, tick:, 0], np.tile(position[:, tick, 0, None], TICKS + 1 - tick))
    reported = vector(crashed.folder, "measurements", "gnss.position_ned")
    assert np.isnan(reported[:, tick:, 0]).all()
    assert np.isfinite(reported[:, :tick]).all()
    assert np.isfinite(reported[:, :, 1:]).all()


# ---------------------------------------------------------------- wrong usage


@pytest.fixture
def no_simulation(monkeypatch):
    """Fail where anything would be compiled."""

    def built(*arguments: Any, **options: Any) -> None:
        raise AssertionError("a simulation was made")

    monkeypatch.setattr(recorder, "Simulation", built)


WRONG = {
    "no such scenario": (["outdor_patrol"], "no scenario is called 'outdor_patrol'; did you mean 'outdoor_patrol'?"),
    "no such file": (["nothing/mine.yaml"], "nothing/mine.yaml: no such file"),
    "no such parameter": (
        ["--set", "world.wind.sped_20ft=7"],
        "world.wind.sped_20ft: no such parameter of 'log_shear'; did you mean 'speed_20ft'?",
    ),
    "no such type": (["--set", "world.wind.type=log_sheer"], "no such type 'log_sheer'; did you mean 'log_shear'?"),
    "no such part": (
        ["--set", "wrld.wind.speed_20ft=7"],
        "wrld: no such parameter of 'scenario'; did you mean 'world'",
    ),
    "out of range": (["--set", "world.wind.speed_20ft=-1"], "world.wind.speed_20ft: -1 is out of range; allowed: 0 to"),
    "not a number": (["--set", "world.wind.speed_20ft=fast"], "world.wind.speed_20ft: 'fast' is not a number"),
    "nan": (["--set", "world.wind.speed_20ft=.nan"], "world.wind.speed_20ft: nan is not a finite number"),
    "no equals sign": (["--set", "duration"], "--set duration: expected path=value"),
    "negative duration": (["--duration", "-3"], "--duration -3: expected a positive number of seconds"),
    "no duration": (["--duration", "0"], "--duration 0: expected a positive number of seconds"),
    "duration nan": (["--duration", "nan"], "--duration nan: expected a positive number of seconds"),
    "duration inf": (["--duration", "inf"], "--duration inf: expected a positive number of seconds"),
    "part of a step": (["--duration", "0.03"], "duration: 0.03 s is not a multiple of the time step 0.02 s"),
    "negative seed": (["--seed", "-1"], "--seed -1: expected an integer from 0 to 2**63 - 1"),
    "large seed": (["--seed", str(2**63)], f"--seed {2**63}: expected an integer from 0 to 2**63 - 1"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_usage_is_told_before_anything_is_compiled(case, no_simulation, refused, tmp_path):
    words, message = WRONG[case]
    refused(["run", *words, "--out", str(tmp_path / "run")], message)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "words", [["--seed", "1.5"], ["--duration", "long"], ["--precision", "float16"], ["--dur", "3"]]
)
def test_options_that_do_not_parse(words, no_simulation, capsys):
    assert cli.main(["run", *words]) == 2
    printed = capsys.readouterr().err
    assert words[0] in printed
    assert "qrsim run --help" in printed


def test_several_faults_are_told_at_once(no_simulation, refused):
    words = ["run", "--set", "world.wind.speed_20ft=-1", "--set", "fleets.pelicans.controler=truth"]
    refused(words, "outdoor_patrol: 2 problems", "speed_20ft: -1", "controler: no such parameter")


def test_an_existing_folder_is_refused_before_anything_is_compiled(no_simulation, refused, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    refused(["run", "--out", str(tmp_path)], f"run folder {tmp_path} exists and is never overwritten", "--out")
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_folder_that_cannot_be_made(refused, tmp_path):
    (tmp_path / "file").write_text("")
    words = ["run", "--duration", "0.02", "--out", str(tmp_path / "file" / "run")]
    refused(words, "cannot create the run folder", "Not a directory", code=1)


# ---------------------------------------------------------------- disk full


@pytest.fixture
def small_parts(monkeypatch) -> Iterator[Callable[[int], None]]:
    """Parts of 50 ticks, and a function after which that many more files find space on the disk."""
    real_create, real_fsync = recorder.RunWriter.create, os.fsync
    left = [math.inf]

    def create(folder: Path, **options: Any) -> Any:
        return real_create(folder, flush_rows=50 * VEHICLES * len(STREAMS), **options)

    def fsync(descriptor: int) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real_fsync(descriptor)

    monkeypatch.setattr(recorder, "RunWriter", SimpleNamespace(create=create))
    monkeypatch.setattr(recorder, "LONG_CHUNK_TICKS", 50)
    monkeypatch.setattr(atomic.os, "fsync", fsync)

    def fill(files: int) -> None:
        left[0] = files

    yield fill
    left[0] = math.inf


def test_disk_full_while_recording(small_parts, fly, flown):
    small_parts(25)
    flight = fly("--seed", "3", "--duration", "10")
    assert flight.code == 1
    assert flight.printed == ""
    assert "Traceback" not in flight.complaints
    found = re.search(r"^error: disk full while recording '(\w+)': the log up to t = (\S+) s in", flight.complaints)
    assert found
    run = open_run(flight.folder)
    lengths = {stream: len(run[stream].tick) for stream in STREAMS}
    # Some seconds were recorded, and as much as the message says is there, equal to the run on an empty disk.
    assert 50 < min(lengths.values()) <= max(lengths.values()) < TICKS
    assert float(found[2]) == pytest.approx(0.02 * (min(lengths.values()) - 1))
    for stream in STREAMS:
        count = lengths[stream]
        for name, whole in open_run(flown.folder)[stream].arrays().items():
            np.testing.assert_array_equal(run[stream][name], whole[:count])


def test_disk_full_at_the_figure_keeps_the_numbers(small_parts, fly, monkeypatch):
    def drawn(run: Any) -> Any:
        small_parts(0)
        return SimpleNamespace(savefig=lambda file, **options: file.write(b"picture"))

    monkeypatch.setattr("qrsim.runs.figure.draw_run", drawn)
    flight = fly("--duration", "0.02", "--json")
    assert flight.code == 1
    said = [line for line in flight.complaints.splitlines() if not line.startswith("warning: ")]
    assert said == [f"error: cannot write {flight.folder / 'figure.png'}: No space left on device"]
    assert len(flight.json["vehicles"]) == VEHICLES
    assert flight.json["figure"] is None
    assert open_run(flight.folder).info.state == "finished"


def test_disk_full_at_the_start_leaves_no_folder(small_parts, fly):
    small_parts(2)
    flight = fly("--duration", "1")
    assert flight.code == 1
    assert "error: cannot write in the run folder" in flight.complaints
    assert "No space left on device" in flight.complaints
    assert not flight.folder.exists()


def test_run_json_never_promises_ticks_that_a_stream_does_not_have(fly, monkeypatch):
    """Whenever the process is killed, all streams reach at least the tick that run.json names."""
    real_create, promised, present = recorder.RunWriter.create, [], []

    def create(folder: Path, **options: Any) -> Any:
        writer = real_create(folder, flush_seconds=0.0, **options)
        real_write = writer._write

        def write(batch: Any) -> None:
            real_write(batch)
            promised.append(json.loads((folder / "run.json").read_text())["ticks"])
            present.append(min(rows_of(folder).values()) - 1)

        monkeypatch.setattr(writer, "_write", write)
        return writer

    monkeypatch.setattr(recorder, "RunWriter", SimpleNamespace(create=create))
    monkeypatch.setattr(recorder, "LONG_CHUNK_TICKS", 50)
    assert fly("--duration", "0.3", "--no-figure").code == 0
    assert promised[-1] == present[-1] == 15
    assert all(promise <= max(ticks, 0) for promise, ticks in zip(promised, present, strict=True))


# ---------------------------------------------------------------- real time


class FakeTime:
    """A clock on which every look at it takes ``cost`` seconds."""

    def __init__(self, cost: float):
        self.now, self.cost, self.slept = 0.0, cost, 0.0

    def perf_counter(self) -> float:
        self.now += self.cost
        return self.now

    def time(self) -> float:
        return self.perf_counter()

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.now += seconds
        self.slept += seconds


def test_real_time_waits_for_the_clock(fly, monkeypatch):
    clock = FakeTime(0.001)
    monkeypatch.setattr(recorder, "time", clock)
    result = fly("--duration", "1.02", "--realtime", "--no-figure", "--json").json
    assert result["overruns"] == 0
    # Ten chunks of 0.1 s after the first tick; the flight ends when its time is over, not before and not later.
    assert result["wall_s"] == pytest.approx(1.0, abs=0.005)
    assert clock.slept > 0.9


def test_real_time_on_a_machine_that_is_too_slow(fly, monkeypatch):
    clock = FakeTime(0.2)
    monkeypatch.setattr(recorder, "time", clock)
    printed = fly("--duration", "1.02", "--realtime", "--no-figure").printed
    assert "10 chunks were late: this machine is too slow for real time here" in printed
    assert clock.slept == 0.0


def test_as_fast_as_possible_never_waits(fly, monkeypatch):
    clock = FakeTime(0.001)
    monkeypatch.setattr(recorder, "time", clock)
    result = fly("--duration", "1.02", "--no-figure", "--json").json
    assert (result["overruns"], clock.slept) == (0, 0.0)


def test_real_time_on_the_real_clock(fly):
    """However busy the machine is, it is never faster than the clock."""
    result = fly("--duration", "0.52", "--realtime", "--no-figure", "--json").json
    assert result["wall_s"] >= 0.5 - 1e-3
    assert 0 <= result["overruns"] <= 5


# ---------------------------------------------------------------- stopped from outside


def rows_of(folder: Path) -> dict[str, int]:
    run = open_run(folder)
    return {stream: len(run[stream].tick) for stream in STREAMS}


def wait_for_ticks(process: subprocess.Popen[str], folder: Path, seconds: float = 240.0) -> None:
    """Wait until there is a tick on the disk."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if process.poll() is not None:
            pytest.fail(f"the run ended by itself: {process.communicate()}")
        if (folder / "run.json").is_file() and json.loads((folder / "run.json").read_text())["ticks"] > 0:
            return
        time.sleep(0.05)
    process.kill()
    pytest.fail(f"no tick on the disk after {seconds:g} s: {process.communicate()}")


@pytest.fixture(scope="module")
def stopped(tmp_path_factory, flown):
    """Three runs in real time: name -> (folder, process, its output, ticks of each stream on the disk before)."""
    root = tmp_path_factory.mktemp("stopped")
    started = {}
    for name in ("interrupted", "terminated", "killed"):
        words = ["run", "--realtime", "--duration", "1000", "--out", str(root / name)]
        started[name] = subprocess.Popen(
            [sys.executable, "-c", INTERRUPTIBLE, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
    found = {}
    try:
        ends = (("interrupted", signal.SIGINT), ("terminated", signal.SIGTERM), ("killed", signal.SIGKILL))
        for name, number in ends:
            process, folder = started[name], root / name
            wait_for_ticks(process, folder)
            lengths = rows_of(folder)
            time.sleep(0.5)  # half a second of flight that no flush has written yet
            process.send_signal(number)
            found[name] = (folder, process, process.communicate(timeout=60), lengths)
    finally:
        for process in started.values():
            process.kill()
    return found


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
@pytest.mark.parametrize(
    ("name", "code", "message"),
    [("interrupted", 130, "stopped by the user"), ("terminated", 143, "stopped by SIGTERM")],
)
@pytest.mark.long
def test_ctrl_c_and_sigterm_keep_the_log_to_the_moment(stopped, name, code, message):
    folder, process, (out, err), before = stopped[name]
    assert (process.returncode, out) == (code, "")
    assert err == f"{name}; the log so far is in {folder}\n{name}\n"
    run = open_run(folder)
    assert (run.info.state, run.info.message) == ("interrupted", message)
    # Also what no flush had written yet, of every stream.
    assert run.info.ticks + 1 > max(before.values())
    for stream in STREAMS:
        np.testing.assert_array_equal(run[stream].tick, np.arange(run.info.ticks + 1))


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
@pytest.mark.long
def test_kill_leaves_a_readable_log(stopped):
    folder, process, (out, err), before = stopped["killed"]
    assert (process.returncode, out, err) == (-signal.SIGKILL, "", "")
    run = open_run(folder)
    assert (run.info.state, run.info.ended) == ("running", None)
    assert run.info.ticks > 0
    for stream in STREAMS:
        assert len(run[stream].tick) >= before[stream] > 0
        np.testing.assert_array_equal(run[stream].tick, np.arange(len(run[stream].tick)))


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
@pytest.mark.parametrize("name", ["interrupted", "killed"])
@pytest.mark.long
def test_a_stopped_run_can_be_drawn(stopped, name, capsys):
    folder = stopped[name][0]
    assert cli.main(["plot", str(folder)]) == 0
    assert capsys.readouterr().out == f"{folder / 'figure.png'}\n"
    assert (folder / "figure.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")


@pytest.mark.long
def test_a_plain_run_compiles_nothing_by_xla(tmp_path):
    """In a new process, because this one has compiled programs already."""
    command = [sys.executable, "-m", "qrsim.cli", "run", "mixed_team", "--duration", "0.1", "--no-figure"]
    found = subprocess.run(
        command, cwd=tmp_path, env=os.environ | {"JAX_LOG_COMPILES": "1"}, capture_output=True, text=True, check=True
    )
    assert "start-up" in found.stdout
    assert "Compiling" not in found.stderr
    # What the setting prints where something is compiled.
    alone = [sys.executable, "-c", "import jax; jax.jit(lambda x: x + 1)(1.0)"]
    assert "Compiling" in subprocess.run(
        alone, env=os.environ | {"JAX_LOG_COMPILES": "1"}, capture_output=True, text=True, check=True
    ).stderr  # fmt: skip


@pytest.mark.parametrize(("text", "expected"), [("20", 20.0), ("20s", 20.0), ("2min", 120.0), ("1.5 h", 5400.0)])
def test_a_time_may_have_a_unit(text: str, expected: float) -> None:
    assert seconds_of(text) == expected


def test_a_time_with_another_unit_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["run", "hover", "--duration", "3 parsec"]) == 2
    assert "'3 parsec' is no time; expected seconds" in " ".join(capsys.readouterr().err.split())
