"""What is injected in flight is kept, written, read, and made again: to the bit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.small_worlds import pair

from qrsim.cli import main
from qrsim.core.tree import replace
from qrsim.errors import UsageError
from qrsim.runs import open_run
from qrsim.runs.compare import compare_runs
from qrsim.runs.recorder import fly
from qrsim.scenarios.injection_file import read_injections
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.simulation.injections import LAST_TICK
from qrsim.simulation.schedule import Schedule
from qrsim.simulation.simulation import Simulation

TICKS, DT = 60, 0.02
WIND = {"type": "log_shear", "speed_20ft": 2.0, "wind_from_deg": 270.0}
# Target, kind and numbers of faults of the pair.
FAULTS: list[tuple[str, str, dict[str, Any]]] = [
    ("gnss", "off", {}),
    ("gnss", "stuck", {}),
    ("gnss", "wrong", {"field": "position_ned.x", "bias": 2.0}),
    ("gnss", "intermittent", {"share": 0.5}),
    ("barometer", "noisy", {"field": "height", "std": 0.5}),
    ("barometer", "garbage", {"field": "height", "range": 3.0}),
    ("barometer", "drift", {"field": "height", "rate": -0.7, "limit": 0.4}),
    ("barometer", "slow", {"every": 4}),
]
NAMES = ("vehicles_0", "vehicles_1")


def content(**world: Any) -> dict[str, Any]:
    found: dict[str, Any] = pair(wind=WIND, duration=TICKS * DT).spec.model_dump(mode="json")
    found["world"] |= world
    return found


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    found = content(injectable=["wind"])
    found["fleets"]["vehicles"]["injectable"] = {"sensors": ["gnss", "barometer"]}
    return load_scenario(found, quiet=True)


def simulation(scenario: Scenario, precision: str = "float32") -> Simulation:
    found = Simulation(scenario.world(precision), seed=4, name=scenario.name)
    found.reset()
    return found


def flown(simulation: Simulation, each: Callable[[int], object]) -> np.ndarray:
    """Return truth, readings and wind of every tick; ``each`` is called before it."""
    rows = []
    for tick in range(TICKS):
        each(tick)
        reading, state = simulation.step(), simulation.state.fleets[0]
        parts = [simulation.truth.position_ned, reading.gnss.position_ned, reading.barometer.height[:, None]]
        rows.append(np.concatenate([*parts, np.stack([state.mean_wind_ned.x, state.mean_wind_ned.y], 1)], axis=1))
    return np.array(rows)


def asks(rng: np.random.Generator, count: int) -> dict[int, list[tuple[str, tuple[Any, ...], dict[str, Any]]]]:
    """Return a method of a simulation and its arguments, by tick; none is for a target of the tick before."""
    found: dict[int, list[tuple[str, tuple[Any, ...], dict[str, Any]]]] = {}
    for tick in sorted(rng.choice(np.arange(1, TICKS - 6), count, replace=False).tolist()):
        choice = rng.integers(4)
        names = [NAMES[:1], NAMES[1:], NAMES][rng.integers(3)]
        if choice == 0:
            call = ("clear", (["gnss", "barometer"][rng.integers(2)],), {"vehicles": names})
        elif choice == 1:
            over = [0.0, 0.3][rng.integers(2)]
            call = ("set_wind", (float(rng.integers(1, 9)), float(rng.integers(0, 360)), over), {})
        else:
            target, kind, numbers = FAULTS[rng.integers(len(FAULTS))]
            duration = [None, 0.2][rng.integers(2)]
            call = ("inject", (target, kind), {"vehicles": names, "duration": duration, **numbers})
        found.setdefault(tick, []).append(call)
    return found


def live(scenario: Scenario, calls: dict[int, Any], precision: str) -> tuple[np.ndarray, Simulation]:
    flying = simulation(scenario, precision)

    def call(tick: int) -> None:
        for name, arguments, named in calls.get(tick, ()):
            getattr(flying, name)(*arguments, **named)

    return flown(flying, call), flying


def from_file(scenario: Scenario, path: Path, precision: str) -> np.ndarray:
    with_room, again = read_injections(scenario, path)
    flying = simulation(with_room, precision)
    schedule = Schedule(flying, again)
    return flown(flying, lambda tick: schedule.make())


def seconds(tick: int) -> float:
    return round(tick * DT, 9)


def in_scenario(requests: list[Any]) -> Scenario:
    """Return the scenario with the same faults at set times, each to where the next of its target is asked for."""
    found = content()
    faults: list[dict[str, Any]] = []
    for number, one in enumerate(requests):
        if one.target == "world":
            wind = dict(one.numbers)
            found["world"]["events"] = [*found["world"].get("events", []), {"at": seconds(one.tick), "wind": wind}]
        elif one.kind != "ok":
            for vehicle in one.vehicles:
                later = [
                    other.tick + 1
                    for other in requests[number + 1 :]
                    if other.target == one.target and vehicle in other.vehicles
                ]
                end = min([one.end_tick, *later])
                fault = {
                    "sensor": one.target,
                    "kind": one.kind,
                    "start": seconds(one.start_tick),
                    "vehicles": [vehicle],
                }
                faults.append(fault | dict(one.numbers) | ({"end": seconds(end)} if end < LAST_TICK else {}))
    found["fleets"]["vehicles"]["faults"] = faults
    return load_scenario(found, quiet=True)


def check(scenario: Scenario, seed: int, count: int, path: Path, precision: str, scheduled: bool) -> None:
    calls = asks(np.random.default_rng(seed), count)
    expected, flying = live(scenario, calls, precision)
    requests = flying.requests
    flying.write_requests(path)
    np.testing.assert_array_equal(from_file(scenario, path, precision), expected)
    if scheduled:
        again = simulation(in_scenario(requests), precision)
        np.testing.assert_array_equal(flown(again, lambda tick: None), expected)
    # It is another flight than one in which nothing happens.
    plain, _ = live(scenario, {}, precision)
    assert not np.array_equal(plain, expected, equal_nan=True)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_is_asked_for_in_flight_is_flown_again_from_its_file(
    scenario: Scenario, tmp_path: Path, seed: int
) -> None:
    check(scenario, seed, 10, tmp_path / "asked.yaml", "float32", scheduled=False)


@pytest.mark.long
def test_a_live_injection_is_the_same_as_one_of_the_scenario(scenario: Scenario, tmp_path: Path) -> None:
    check(scenario, 5, 10, tmp_path / "asked.yaml", "float32", scheduled=True)


@pytest.mark.nightly
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_twenty_sequences_of_ten(scenario: Scenario, tmp_path: Path, precision: str) -> None:
    for seed in range(20):
        check(scenario, 100 + seed, 10, tmp_path / f"{seed}.yaml", precision, scheduled=True)


FILE = """
- {target: gnss, kind: off, at: 0.2, end: 0.6}
- {target: gnss, kind: wrong, field: position_ned.x, bias: 3.0, at: 0.4, vehicles: [vehicles_0]}
- {target: world, kind: wind, at: 0.5, speed_20ft: 8, over: 0.2}
- {target: gnss, kind: ok, at: 0.8, vehicles: [vehicles_0]}
- {target: barometer, kind: off, tick: 60, at: 1.22, vehicles: [vehicles_0]}
"""


@pytest.fixture(scope="module")
def recorded(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the file, with a wind that a caller of its own changes too."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "faults.yaml").write_text(FILE)
    with_room, requests = read_injections(scenario, folder / "faults.yaml")
    fly(with_room, folder / "run", seed=2, precision="float32", injections=requests)
    return folder / "run"


def test_a_run_has_what_was_asked_for_and_is_flown_again_to_the_bit(recorded: Path, tmp_path: Path) -> None:
    run = open_run(recorded)
    assert [(one["target"], one["kind"], one["tick"], one["at"], one.get("end")) for one in run.injections] == [
        ("gnss", "off", 9, 0.2, 0.6),
        ("gnss", "wrong", 19, 0.4, None),
        ("world", "wind", 25, 0.5, None),
        ("gnss", "ok", 39, 0.8, None),
        # After the last tick: it changes nothing.
        ("barometer", "off", 60, 1.22, None),
    ]
    assert [one["vehicles"] for one in run.injections if "vehicles" in one] == [
        list(NAMES),
        ["vehicles_0"],
        ["vehicles_0"],
        ["vehicles_0"],
    ]
    events = [(event.kind, event.vehicle, event.field, event.value, event.tick) for event in run.events]
    assert [event for event in events if event[0] in ("injected", "cleared", "wind_changed")] == [
        ("injected", "vehicles_0", "gnss", None, 9),
        ("injected", "vehicles_1", "gnss", None, 9),
        ("injected", "vehicles_0", "gnss.position_ned.x", 3.0, 19),
        ("wind_changed", None, "world.wind.speed_20ft", 8.0, 25),
        ("cleared", "vehicles_0", "gnss", None, 39),
        ("injected", "vehicles_0", "barometer", None, 60),
    ]
    fix = run["measurements"]["gnss.position_ned.x"]
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(fix[:, 1])), np.arange(10, 30))
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(fix[:, 0])), np.arange(10, 20))
    speed = run["wind"]["mean_ned.y"][:, 0]
    assert speed[26] < 0.5 * speed[40]
    np.testing.assert_allclose(speed[31] - speed[26], 0.5 * (speed[40] - speed[20]), rtol=0.01)
    arguments = [str(recorded / "scenario.yaml"), "--inject", str(recorded / "injections.yaml"), "--seed", "2"]
    main(["run", *arguments, "--out", str(tmp_path / "again"), "--no-figure"])
    again = open_run(tmp_path / "again")
    found = compare_runs(run, again)
    assert found.bit_identical
    assert (found.injections.equal, found.injections.only) == (5, ((), ()))
    assert (recorded / "injections.yaml").read_bytes() == (tmp_path / "again" / "injections.yaml").read_bytes()


def test_runs_are_compared_by_their_injections(recorded: Path, tmp_path: Path, capsys: Any) -> None:
    import shutil

    shutil.copytree(recorded, tmp_path / "other")
    lines = (recorded / "injections.yaml").read_text("utf-8").splitlines(keepends=True)
    # Who asked makes no difference, and is no text that a terminal obeys.
    other = "".join(lines[:3]).replace("asked_by: file", "asked_by: page").replace("speed_20ft: 8", "speed_20ft: 9")
    (tmp_path / "other" / "injections.yaml").write_text(other, "utf-8")
    assert main(["compare", str(recorded), str(tmp_path / "other")]) == 0
    said = capsys.readouterr().out
    assert "injections: 2 equal, 3 only in A, 1 only in B" in said
    assert "only in B: {target: world, kind: wind, tick: 25, at: 0.5, speed_20ft: 9, over: 0.2" in said
    (tmp_path / "other" / "injections.yaml").write_text("{", "utf-8")
    assert main(["compare", str(recorded), str(tmp_path / "other")]) == 1
    assert "injections.yaml is damaged" in capsys.readouterr().err


def test_requests_are_kept_until_a_reset(scenario: Scenario) -> None:
    flying = simulation(scenario)
    flying.inject("gnss", "off", "vehicles_1", asked_by="me")
    flying.set_wind(8.0, 90.0)
    flying.step(ticks=3)
    flying.clear(asked_by="you")
    with pytest.raises(UsageError, match="allowed: wind, gusts, jam"):
        flying.inject("world", "off")
    # What ends nothing is no request.
    flying.clear("barometer")
    flying.inject("barometer", "ok")
    found = [(one.id, one.target, one.kind, one.tick, one.start_tick, one.asked_by) for one in flying.requests]
    assert found == [
        (1, "gnss", "off", 0, 1, "me"),
        (0, "world", "wind", 0, 0, "python"),
        (0, "gnss", "ok", 3, 3, "you"),
    ]
    flying.reset()
    assert flying.requests == []
    flying.step(ticks=2)
    # From the west again, 2 m/s.
    wind = flying.state.fleets[0].mean_wind_ned
    assert wind.y[0] > 1.5


def test_a_saved_state_has_the_weather_that_was_asked_for(scenario: Scenario) -> None:
    flying = simulation(scenario)
    flying.step(ticks=4)
    flying.set_wind(8.0, 90.0, over=0.4)
    flying.step(ticks=10)
    saved = flying.save()
    other = simulation(scenario)
    other.load(saved)
    flying.step(ticks=15)
    other.step(ticks=15)
    np.testing.assert_array_equal(other.truth.state, flying.truth.state)
    assert other.state.fleets[0].mean_wind_ned.y[0] < -7.0
    other.reset()
    other.step()
    assert other.state.fleets[0].mean_wind_ned.y[0] > 1.5


def test_another_world_keeps_what_was_injected(scenario: Scenario) -> None:
    flying = simulation(scenario)
    before = flying.world
    flying.inject("gnss", "off", "vehicles_1")
    flying.change_world(before)
    assert len(flying.injected) == 1
    assert np.isnan(flying.step(ticks=10).gnss.position_ned).any(axis=1).tolist() == [False, True]
    faulty = flying.world
    flying.reset()
    flying.change_world(faulty)
    assert not np.isnan(flying.step(ticks=10).gnss.position_ned).any()
    # A reset restores the wind of the scenario, 2 m/s from the west, unless the other world has another.
    flying.set_wind(8.0, 90.0)
    flying.change_world(replace(flying.world, fleets=before.fleets))
    flying.reset()
    flying.step(ticks=2)
    assert flying.state.fleets[0].mean_wind_ned.y[0] > 1.5


def test_a_recording_of_others_is_checked(scenario: Scenario, recorded: Path, tmp_path: Path) -> None:
    from qrsim.errors import RunError

    for text in ("[1, 2]", "{a: 1}", "- [", "\x00"):
        folder = tmp_path / str(len(text))
        folder.mkdir(exist_ok=True)
        for name in ("run.json", "scenario.yaml"):
            (folder / name).write_bytes((recorded / name).read_bytes())
        (folder / "injections.yaml").write_text(text, "utf-8")
        with pytest.raises(RunError, match=r"injections\.yaml is damaged"):
            _ = open_run(folder).injections
    (tmp_path / "bad.yaml").write_text("- {target: gnss, kind: off, at: 2, tick: -1}")
    with pytest.raises(UsageError, match="entry 1: tick: -1; allowed: a whole number from 0"):
        read_injections(scenario, tmp_path / "bad.yaml")
