"""Every benchmark runs, in its smallest form; its numbers are looked at only for their kind."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from qrsim import load_scenario

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"
NAMES = sorted(path.stem for path in FOLDER.glob("[!_]*.py"))
MACHINE = {"cpu", "cores", "load_average", "os", "python", "jax", "jaxlib", "qrsim"}
# The keys of a row that are numbers above zero.
NUMBERS = {
    "latency": {"calls", "median_us", "p95_us", "p99_us"},
    "serve": {"count", "median_us", "p95_us", "per_second", "target"},
    "startup": {"runs", "wall_s", "wall_max_s", "cpu_s"},
    "throughput": {"vehicles", "ticks", "compile_s", "us_per_step", "per_wall_second", "per_cpu_second", "flying"},
    "view": {"vehicles", "per_second"},
}


@pytest.fixture
def common(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module that the benchmarks share."""
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module("_common")


def rows(name: str) -> list[dict[str, Any]]:
    command = [sys.executable, str(FOLDER / f"{name}.py"), "--quick", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    report = json.loads(done.stdout)
    assert report["benchmark"] == name
    assert set(report["machine"]) == MACHINE
    assert len(report["machine"]["load_average"]) == 3
    for row in report["results"]:
        assert set(row) >= NUMBERS[name]
        assert all(row[key] > 0 for key in NUMBERS[name])
    return report["results"]


def test_every_benchmark_is_tested():
    assert set(NUMBERS) == set(NAMES)


def test_startup():
    results = rows("startup")
    assert [row["target_s"] for row in results] == [None, None, 10.0, None, 3.0, None]
    for first_tick, whole in (results[2:4], results[4:6]):
        assert 0.0 < first_tick["wall_s"] < whole["wall_s"]
    assert all(row["wall_s"] <= row["wall_max_s"] for row in results)


def test_throughput():
    [row] = rows("throughput")
    assert row["vehicles"] == row["flying"] == 1
    assert row["per_wall_second"] == pytest.approx(1e6 / row["us_per_step"], rel=0.01)


def test_serve():
    assert [row["target"] for row in rows("serve")] == [3000.0, 8000.0, 200_000.0]


def test_latency():
    [row] = rows("latency")
    assert row["median_us"] <= row["p95_us"] <= row["p99_us"]


def test_the_table_names_the_machine(common, capsys):
    results = [{"what": "first", "count": 12345, "wall_s": 0.012345, "target_s": 3.0, "hidden": 1.0}]
    results.append(results[0] | {"what": "second", "target_s": None, "wall_s": 123.45})
    headings = {"what": "what", "count": "count", "wall_s": "wall [s]", "target_s": "target [s]"}
    common.publish("name", "A title", common.machine(), results, headings, as_json=False)
    printed = capsys.readouterr().out
    lines = [line.split() for line in printed.splitlines()]
    assert lines[0] == ["A", "title"]
    assert ["first", "12,345", "0.0123", "3.00"] in lines
    assert ["second", "12,345", "123", "-"] in lines
    assert "wall [s]" in printed
    assert "load average" in printed
    assert f"Python {sys.version.split()[0]}, jax " in printed


@pytest.mark.parametrize("count", [1, 7, 1000])
def test_the_scaled_scenario_is_the_default_one_with_more_vehicles(count, common):
    spec, default = load_scenario(common.patrol(count)).spec, load_scenario("outdoor_patrol").spec
    vehicles = spec.fleets["pelicans"].vehicles
    assert len(vehicles) == count
    assert len({tuple(vehicle.position_ned) for vehicle in vehicles}) == count
    for part in ("wind", "turbulence", "sky", "collision_distance"):
        assert getattr(spec.world, part) == getattr(default.world, part)
    for part in ("vehicle", "controller", "guidance", "limits", "sensors"):
        assert getattr(spec.fleets["pelicans"], part) == getattr(default.fleets["pelicans"], part)


def test_view():
    results = rows("view")
    updates = [row for row in results if row["cpu_ms"] is not None]
    assert [(row["vehicles"], row["clients"]) for row in updates] == [(2, 0), (2, 0), (2, 2), (2, 2)]
    assert all((row["client_bytes_per_second"] or 0) > 0 for row in updates if row["clients"])
    assert [row["what"] for row in results[4:]] == ["run, times real time", "run with page", "its frames"]
