"""Faults that are injected in flight: what they do, that nobody else notices, and what is refused."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from scipy.stats import kstest

import qrsim
from qrsim.engine import by_llvm
from qrsim.errors import ScenarioError, UsageError
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.injections import injected

ALL = {"sensors": "all", "rotors": "all", "battery": True, "delay_max": 0.4}


def scenario(injectable: Any = None, *faults: dict[str, Any], **more: Any) -> dict[str, Any]:
    sensors = {
        "gnss": {"type": "gnss"},
        "baro": {"type": "barometer"},
        "imu": {"type": "imu"},
        "mag": {"type": "magnetometer"},
    }
    fleet = {
        "vehicle": {"type": "multirotor", "model": "x500", "on_failure": "reallocate"},
        "sensors": sensors,
        "battery": {"type": "lithium_cells"},
        "injectable": injectable,
        "faults": list(faults),
        "vehicles": [{"position_ned": [0.0, 20.0 * i, -30.0]} for i in range(3)],
    }
    return {"name": "injections", "duration": 60.0, "fleets": {"uav": fleet}} | more


def flown(simulation: Any, ticks: int) -> np.ndarray:
    """Return all that changes of each vehicle in so many ticks: truth and readings."""
    rows = []
    for _ in range(ticks):
        reading, truth = simulation.step(), simulation.truth
        parts = [truth.position_ned, reading.gnss.position_ned, reading.baro.height[:, None], reading.imu.rates_body]
        rows.append(np.concatenate([*parts, reading.mag.field_body], axis=1))
    return np.array(rows)


# Sensor, kind, numbers; each begins 0.1 s after the one before and lasts 0.5 s, on vehicle 2.
FAULTS: list[tuple[str, str, dict[str, Any]]] = [
    ("baro", "wrong", {"field": "height", "bias": 1.5, "scale": 0.9}),
    ("mag", "off", {}),
    ("gnss", "drift", {"field": "position_ned", "rate": 0.5, "limit": 3.0}),
    ("imu", "noisy", {"field": "rates_body", "std": 0.01}),
    ("baro", "delayed", {"by": 0.2}),
    ("mag", "garbage", {"field": "field_body", "range": 40.0}),
    ("gnss", "intermittent", {"share": 0.5}),
    ("baro", "slow", {"every": 7}),
]


def entries() -> list[dict[str, Any]]:
    times = [{"start": round(0.2 + 0.1 * i, 2), "end": round(0.7 + 0.1 * i, 2)} for i in range(len(FAULTS))]
    return [
        {"sensor": sensor, "kind": kind, "vehicles": ["uav_2"], **when, **numbers}
        for (sensor, kind, numbers), when in zip(FAULTS, times, strict=True)
    ]


@pytest.mark.long
@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.nightly)])
def test_live_is_scheduled_is_saved_and_flown_on(precision: str) -> None:
    """To the bit; and of two other vehicles nothing changes."""
    plain = qrsim.load(scenario(), seed=4, precision=precision)
    plain.reset()
    nothing = flown(plain, 90)
    asked = [entry | {"at": entry["start"]} for entry in entries()]
    # One fault of a target at a time: the second of the barometer and the magnetometer begins after the first.
    scheduled = qrsim.load(scenario(None, *_one_at_a_time(entries())), seed=4, precision=precision)
    scheduled.reset()
    expected = flown(scheduled, 90)
    live = qrsim.load(scenario(ALL), seed=4, precision=precision)
    live.reset()
    np.testing.assert_array_equal(flown(live, 5), nothing[:5])
    said, saved = [], b""
    for tick in range(5, 90):
        for (sensor, kind, numbers), entry in zip(FAULTS, asked, strict=True):
            if round(entry["at"] / 0.02) == tick + 1:
                # Numbers of NumPy and any iterable of names will do, and can be saved.
                taken = {
                    name: value if isinstance(value, str) else np.array(value)[()] for name, value in numbers.items()
                }
                live.inject(sensor, kind, iter(["uav_2"]), duration=0.5, **taken)
        if tick == 30:
            saved = live.save()
        said.append(flown(live, 1)[0])
    assert live.save()
    np.testing.assert_array_equal(said, expected[5:])
    np.testing.assert_array_equal(np.array(said)[:, :2], nothing[5:, :2])
    assert not np.array_equal(np.array(said)[:, 2], nothing[5:, 2], equal_nan=True)
    # The faults of a saved state go on, in another simulation too.
    other = qrsim.load(scenario(ALL), seed=4, precision=precision)
    other.load(saved)
    assert [one.target for one in other.injected] == [one[0] for one in FAULTS[3:4]] or len(other.injected)
    np.testing.assert_array_equal(flown(other, 1)[0], said[25])
    copied = pickle.loads(pickle.dumps(other.injected))
    assert [one.target for one in copied] == [one.target for one in other.injected]
    other.clear()
    # Once they are cleared, a state is one of this scenario again.
    qrsim.load(scenario(ALL), seed=4, precision=precision).load(other.save())
    other.reset()
    assert len(other.injected) == 0
    np.testing.assert_array_equal(flown(other, 20), nothing[:20])


def _one_at_a_time(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return faults of which each ends where the next of its sensor begins."""
    for i, entry in enumerate(entries):
        later = [other["start"] for other in entries[i + 1 :] if other["sensor"] == entry["sensor"]]
        entry["end"] = min([entry["end"], *later])
    return entries


def speeds(simulation: Any) -> np.ndarray:
    """Return the speeds of the rotors of the first vehicle [rad/s]."""
    return np.array([rotor[0] for rotor in simulation.state.fleets[0].vehicle.rotor_speed])


@pytest.mark.long
def test_rotors_and_batteries_fail_and_are_well_again() -> None:
    simulation = qrsim.load(scenario(ALL), seed=4)
    simulation.reset()
    simulation.step(ticks=50)
    simulation.inject("rotor 0", "weak", "uav_0", duration=0.5, health=0.8)
    simulation.inject("battery", "drop", "uav_1", charge=0.4)
    before = speeds(simulation)
    simulation.step(ticks=20)
    state = simulation.state.fleets[0]
    assert speeds(simulation)[0] < 0.93 * before[0]
    np.testing.assert_allclose(state.battery.charge, [1.0, 0.4, 1.0], atol=0.01)
    simulation.step(ticks=150)
    assert simulation.valid.all()
    np.testing.assert_allclose(speeds(simulation), before, rtol=0.05)
    np.testing.assert_allclose(simulation.state.fleets[0].battery.charge, [1.0, 0.4, 1.0], atol=0.01)


@pytest.mark.long
def test_every_episode_draws_when_a_sensor_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """By one compiled program: uniform times, rounded down to a tick; the same seeds draw the same ones."""
    made: list[object] = []
    build = by_llvm.build
    monkeypatch.setattr(by_llvm, "build", lambda *parts, **named: made.append(parts) or build(*parts, **named))
    content = scenario(None, {"sensor": "baro", "kind": "off", "start": 1.0, "vehicles": ["uav_0"]})
    content["ranges"] = [{"path": "fleets.uav.faults.0.start", "low": 0.2, "high": 1.8}]
    look = lambda state: state.fleets[0].readings[1].height  # noqa: E731

    def flown(first: int = 0) -> np.ndarray:
        rolled = qrsim.rollout(content, seeds=range(first, first + 200), ticks=100, record=look, record_every=1)
        heights = np.asarray(rolled.recorded)
        assert heights.shape == (200, 101, 3)
        return heights

    heights = flown()
    failed = np.isnan(heights[..., 0])
    assert failed.any(axis=1).all()
    first = failed.argmax(axis=1)
    assert (first.min() >= 10, first.max() < 90) == (True, True)
    assert kstest(first, "uniform", (10.0, 80.0)).pvalue > 0.01
    assert not np.isnan(heights[..., 1:]).any()
    # What starts and what flies episodes was compiled once.
    count = len(made)
    assert count <= 2
    np.testing.assert_array_equal(flown(), heights)
    assert not np.array_equal(flown(200), heights, equal_nan=True)
    assert len(made) == count


WORLD = load_scenario(scenario({"sensors": ["gnss", "baro"], "rotors": [1], "delay_max": 0.4})).world()


@pytest.mark.parametrize(
    ("target", "kind", "numbers", "message"),
    [
        ("gnsss", "off", {}, "target: there is no 'gnsss'; did you mean 'gnss'?"),
        ("imu", "off", {}, "target: 'imu' is not injectable; write 'injectable: {sensors: [imu]}' under fleets.uav"),
        ("battery", "drop", {"charge": 0.1}, "write 'injectable: {battery: true}' under fleets.uav"),
        ("rotor 3", "off", {}, "target: 'rotor 3' is not injectable; write 'injectable: {rotors: all}'"),
        ("gnss", "of", {}, "kind: 'of' is not known; did you mean 'off'?"),
        ("rotor_1", "drift", {}, "kind: 'drift' does not suit a rotor; allowed: off, weak, ok"),
        ("rotor 1", "weak", {"health": 1.2}, "health: 1.2; allowed: 0 to 1"),
        ("rotor 1", "weak", {}, "health: missing; kind 'weak' needs it, 0 to 1"),
        ("rotor 1", "off", {"health": 0.5}, "health: kind 'off' does not take it"),
        ("gnss", "drift", {"field": "position_ned.x"}, "rate: missing; kind 'drift' needs it"),
        ("gnss", "drift", {"field": "position_ned.x", "rate": float("nan")}, "rate: nan; allowed: a finite number"),
        ("gnss", "drift", {"field": "height", "rate": 1.0}, "field: the sensor does not report 'height'"),
        ("gnss", "noisy", {"field": "position_ned", "std": "1"}, "std: '1'; allowed: a number"),
        ("gnss", "wrong", {"field": "position_ned", "bias": 10**400}, "bias: 1000"),
        ("gnss", "off", {"bia": 2.0}, "bia: there is no such number; did you mean 'bias'?"),
        ("gnss", "off", {"bias": 2.0}, "bias: only for kind 'wrong', not 'off'"),
        ("gnss", "slow", {"every": 0}, "every: 0; allowed: 1 to 1e+06"),
        ("gnss", "intermittent", {"share": 0.9, "on": 3.0}, "share: kind 'intermittent' needs it alone, or on and off"),
        ("gnss", "intermittent", {"share": -0.1}, "share: -0.1; allowed: 0 to 1"),
        ("gnss", "delayed", {"by": 3.0}, "by: 3 s; allowed: at most 0.4 s, injectable.delay_max of the scenario"),
    ],
)
def test_what_cannot_be_injected(target: str, kind: str, numbers: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError) as caught:
        injected(WORLD, target, kind, None, (5, 10), numbers)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_fields_have_numbers_of_their_own() -> None:
    numbers = {"bias": {"position_ned.x": 3.0, "velocity_ned": -1.0}, "scale": {"position_ned.y": 0.5}}
    world, _ = injected(WORLD, "gnss", "wrong", ["uav_1"], (5, 10), numbers)
    slot = world.fleets[0].fault_slots[0]
    added = {name: float(amount[1]) for name, amount in zip(slot.fields, slot.numbers.amounts, strict=True)}
    times = {name: float(scale[1]) for name, scale in zip(slot.fields, slot.numbers.scales, strict=True)}
    velocity = {f"velocity_ned.{axis}": -1.0 for axis in "xyz"}
    assert {name: value for name, value in added.items() if value} == {"position_ned.x": 3.0} | velocity
    assert {name: value for name, value in times.items() if value != 1.0} == {"position_ned.y": 0.5}
    # Vehicle 0 has no fault.
    assert not any(float(amount[0]) for amount in slot.numbers.amounts)
    for wrong, message in (
        ({"bias": {"position.x": 1.0}}, "field: the sensor does not report 'position.x'"),
        ({"bias": {3: 1.0}}, "field: the sensor does not report '3'"),
        ({"bias": {"position_ned.x": "1"}}, "bias: '1'; allowed: a number"),
        ({"bias": {"position_ned.x": float("nan")}}, "bias: nan; allowed: a finite number"),
        ({"bias": {}}, "bias: {}; allowed: a number"),
        ({"bias": {"position_ned.x": 1.0}, "field": "position_ned"}, "field: bias already names fields"),
    ):
        with pytest.raises(UsageError) as caught:
            injected(WORLD, "gnss", "wrong", None, (5, 10), wrong)
        assert message in str(caught.value)


def test_requests_at_a_bad_time_or_too_many() -> None:
    simulation = qrsim.Simulation(WORLD)
    for words, message in (
        ({"at": -1.0}, "at: -1 s is past; it is 0 s now"),
        ({"at": float("nan")}, "at: nan; allowed: a time [s]"),
        ({"duration": 0.0}, "duration: 0.0; allowed: a time above 0 s"),
        ({"vehicles": "uav_7"}, "vehicles: no vehicle is called 'uav_7'"),
    ):
        with pytest.raises(UsageError, match=message.replace("[", r"\[")):
            simulation.inject("baro", "off", **words)
    assert len(simulation.injected) == 0
    for _ in range(64):
        simulation.inject("baro", "off", at=0.9, duration=0.05)
    with pytest.raises(UsageError, match="at most 64 faults in one tick"):
        simulation.inject("baro", "off")
    # The last one stands in place of the others; 0.9 s is tick 45, 0.05 s three ticks.
    assert [(one.start_tick, one.end_tick) for one in simulation.injected] == [(45, 48)]
    with pytest.raises(UsageError, match="vehicles: none is named"):
        simulation.clear("baro", vehicles=[])
    simulation.clear("baro")
    simulation.clear("baro")
    assert len(simulation.injected) == 0
    with pytest.raises(UsageError, match="no vehicle is called 'uav_7'"):
        simulation.clear("baro", vehicles="uav_7")
    with pytest.raises(UsageError, match="kind 'ok' ends a fault at once"):
        simulation.inject("baro", "ok", duration=1.0)
    with pytest.raises(UsageError, match="did you mean 'baro'"):
        simulation.clear("baroo")


@pytest.mark.parametrize(
    ("injectable", "message"),
    [
        ({"sensors": ["barro"]}, "injectable.sensors: no sensor is called 'barro'; did you mean 'baro'?"),
        ({"rotors": [4]}, "injectable.rotors: the vehicle has no rotor 4; allowed: 0 to 3"),
        ({"delay_max": -1}, "injectable"),
        ({"sensor": ["baro"]}, "did you mean 'sensors'?"),
        ("everything", "injectable"),
    ],
)
def test_what_a_scenario_may_not_say(injectable: Any, message: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(scenario(injectable)).world()
    assert message in str(caught.value)
