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
from qrsim.simulation.injections import Injection, injected, without_faults
from qrsim.simulation.requests import entry_of, events_of

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
    # A rotor that is stuck turns at 0.9 of its largest speed whatever is asked of it; the controller meets it.
    simulation.inject("rotor 2", "stuck", "uav_0", duration=0.4, speed=0.9)
    simulation.step(ticks=15)
    largest = float(simulation.world.fleets[0].vehicle.speed_max)  # type: ignore[attr-defined]
    assert speeds(simulation)[2] == pytest.approx(0.9 * largest, rel=0.03)
    assert speeds(simulation)[2] > 1.1 * before[2]
    simulation.step(ticks=150)
    np.testing.assert_allclose(speeds(simulation), before, rtol=0.1)


def charges(simulation: Any, ticks: int) -> np.ndarray:
    """Return the charge that each vehicle uses in so many ticks."""
    begun = simulation.state.fleets[0].battery.charge
    simulation.step(ticks=ticks)
    return np.asarray(begun - simulation.state.fleets[0].battery.charge)


@pytest.mark.nightly
def test_a_weak_battery_has_less_capacity_and_voltage() -> None:
    from qrsim.runs.streams import columns, values

    simulation = qrsim.load(scenario(ALL), seed=4, precision="float64")
    simulation.reset()
    simulation.step(ticks=100)
    simulation.inject("battery", "weak", "uav_1", health=0.8, duration=1.0)
    history = simulation.record(50)
    logged = values(simulation.world, history, columns(simulation.world, history))["truth"]["battery.voltage"]
    np.testing.assert_allclose(logged[10] / logged[10, 0], [1.0, 0.8, 1.0], rtol=0.01)
    used = charges(simulation, 50)
    # It is over.
    assert used[1] / used[0] == pytest.approx(1.0, rel=0.02)
    simulation.inject("battery", "weak", "uav_1", health=0.8, duration=1.0)
    used = charges(simulation, 50)
    assert used[1] / used[0] == pytest.approx(1.25, rel=0.05)
    scheduled = qrsim.load(
        scenario(None, {"type": "battery", "at": 0.5, "health": 0.8, "end": 1.5, "vehicles": ["uav_1"]},
                 {"type": "battery", "at": 1.0, "charge": 0.3, "vehicles": ["uav_2"]},
                 {"type": "rotor", "rotor": 2, "at": 0.5, "speed": 0.8, "end": 0.9, "vehicles": ["uav_0"]}),
        seed=4, precision="float64",
    )  # fmt: skip
    live = qrsim.load(scenario(ALL), seed=4, precision="float64")
    found = []
    for flying in (scheduled, live):
        flying.reset()
        flying.step(ticks=25)
        if flying is live:
            live.inject("battery", "weak", "uav_1", health=0.8, duration=1.0)
            live.inject("battery", "drop", "uav_2", charge=0.3, at=1.0)
            live.inject("rotor 2", "stuck", "uav_0", speed=0.8, duration=0.4)
        flying.step(ticks=70)
        fleet = flying.state.fleets[0]
        found.append(np.concatenate([flying.truth.state.ravel(), fleet.battery.charge, *fleet.vehicle.rotor_speed]))
    np.testing.assert_array_equal(*found)
    assert found[0][-3 * 4 - 1] < 0.3


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
        ("rotor_1", "drift", {}, "kind: 'drift' does not suit a rotor; allowed: off, weak, stuck, ok"),
        ("rotor 1", "weak", {"health": 1.2}, "health: 1.2; allowed: 0 to 1"),
        ("rotor 1", "weak", {}, "health: missing; kind 'weak' needs it, 0 to 1"),
        ("rotor 1", "off", {"health": 0.5}, "health: kind 'off' does not take it"),
        ("rotor 1", "stuck", {"speed": 1.2}, "speed: 1.2; allowed: 0 to 1"),
        ("rotor 1", "stuck", {"health": 0.2}, "health: kind 'stuck' does not take it; it takes speed"),
        ("gnss", "drift", {"field": "position_ned.x"}, "rate: missing; kind 'drift' needs it"),
        ("gnss", "drift", {"field": "position_ned.x", "rate": float("nan")}, "rate: nan; allowed: -1e+15 to 1e+15"),
        ("gnss", "drift", {"field": "height", "rate": 1.0}, "field: the sensor does not report 'height'"),
        ("gnss", "noisy", {"field": "position_ned", "std": "1"}, "std: '1'; allowed: a number"),
        ("gnss", "wrong", {"field": "position_ned", "bias": 10**400}, "bias: 1000"),
        ("gnss", "off", {"bia": 2.0}, "bia: there is no such number; did you mean 'bias'?"),
        ("gnss", "off", {"bias": 2.0}, "bias: only for kind 'wrong', not 'off'"),
        ("gnss", "slow", {"every": 0}, "every: 0; allowed: 1 to 1e+06"),
        ("gnss", "intermittent", {"share": 0.9, "on": 3.0}, "share: kind 'intermittent' needs it alone, or on and off"),
        ("gnss", "intermittent", {"share": -0.1}, "share: -0.1; allowed: 0 to 1"),
        ("gnss", "wrong", {"field": 3, "bias": 1.0}, "field: 3; allowed: a text"),
        ("gnss", "wrong", {"field": "position_ned", "bias": 2e15}, "bias: 2e+15; allowed: -1e+15 to 1e+15"),
        ("radio", "off", {}, "target: there is no radio; give world.radio of the scenario"),
        ("gnss", "ok", {"bias": 2.0}, "bias: kind 'ok' takes no numbers"),
        ("rotor 9", "off", {}, "target: there is no 'rotor 9'; did you mean 'rotor 1'?"),
        ("gnss", "delayed", {"by": 3.0}, "by: 3 s; allowed: at most 0.4 s, injectable.delay_max of the scenario"),
    ],
)
def test_what_cannot_be_injected(target: str, kind: str, numbers: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError) as caught:
        injected(WORLD, target, kind, None, (5, 10), numbers)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_fields_have_numbers_of_their_own() -> None:
    scales = {"position_ned.y": 0.5, "velocity_ned.z": 2.0}
    numbers = {"bias": {"position_ned.x": 3.0, "velocity_ned": -1.0}, "scale": scales}
    world, _ = injected(WORLD, "gnss", "wrong", ["uav_1"], (5, 10), numbers)
    slot = world.fleets[0].fault_slots[0]
    added = {name: float(amount[1]) for name, amount in zip(slot.fields, slot.numbers.amounts, strict=True)}
    times = {name: float(scale[1]) for name, scale in zip(slot.fields, slot.numbers.scales, strict=True)}
    velocity = {f"velocity_ned.{axis}": -1.0 for axis in "xyz"}
    assert {name: value for name, value in added.items() if value} == {"position_ned.x": 3.0} | velocity
    assert {name: value for name, value in times.items() if value != 1.0} == scales
    request = Injection(1, "gnss", "wrong", ("uav_1",), 5, 10, numbers, "test", 4)
    (event,) = events_of([request], 0.02)
    assert (event["field"], event["value"], entry_of(request, 0.02)["bias"]) == ("gnss", None, numbers["bias"])
    # Vehicle 0 has no fault.
    assert not any(float(amount[0]) for amount in slot.numbers.amounts)
    for wrong, message in (
        ({"bias": {"position.x": 1.0}}, "field: the sensor does not report 'position.x'"),
        ({"bias": {3: 1.0}}, "field: the sensor does not report '3'"),
        ({"bias": {"position_ned.x": "1"}}, "bias: '1'; allowed: a number"),
        ({"bias": {"position_ned.x": float("nan")}}, "bias: nan; allowed: -1e+15 to 1e+15"),
        ({"bias": {"position_ned": 1.0, "position_ned.x": 2.0}}, "bias: 'position_ned.x' is given twice"),
        ({"limit": {"position_ned.x": 1.0}}, "limit: {'position_ned.x': 1.0}; allowed: a number, which all fields"),
        ({"bias": {}}, "bias: {}; allowed: a number"),
        ({"bias": {"position_ned.x": 1.0}, "field": "position_ned"}, "field: bias already names fields"),
    ):
        with pytest.raises(UsageError) as caught:
            injected(WORLD, "gnss", "wrong", None, (5, 10), wrong)
        assert message in str(caught.value)


def test_requests_at_a_bad_time_or_too_many() -> None:
    simulation = qrsim.Simulation(WORLD)
    with pytest.raises(UsageError, match=r"not started; call reset\(\) first"):
        simulation.inject("baro", "off")
    simulation.reset()
    for words, message in (
        ({"at": -1.0}, "at: -1 s is past; it is 0 s now"),
        ({"at": float("nan")}, "at: nan; allowed: a time [s]"),
        ({"duration": 0.0}, "duration: 0.0; allowed: a time above 0 s"),
        ({"vehicles": "uav_7"}, "vehicles: no vehicle is called 'uav_7'"),
        ({"vehicles": 7}, "vehicles: 7; allowed: names"),
        ({"asked_by": "one\ntwo"}, "asked_by: .*; allowed: one line of at most 200 characters"),
    ):
        with pytest.raises(UsageError, match=message.replace("[", r"\[")):
            simulation.inject("baro", "off", **words)
    assert len(simulation.injected) == 0
    for _ in range(64):
        simulation.inject("baro", "off", at=0.9, duration=0.05)
    with pytest.raises(UsageError, match="at most 64 faults in one tick"):
        simulation.inject("baro", "off")
    simulation.reset()
    simulation.inject("baro", "off", at=0.9, duration=0.05)
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
    ("fault", "message"),
    [
        ({"type": "battery", "at": 30.0}, "faults.0.charge: missing; a fault of a battery needs it, or health"),
        ({"type": "battery", "at": 30.0, "charge": 1.2}, "faults.0.charge: 1.2 is out of range; allowed: 0 to 1"),
        ({"type": "battery", "at": 30.0, "health": 0.01}, "faults.0.health: 0.01 is out of range; allowed: 0.05 to 1"),
        ({"type": "battery", "at": 30.01, "charge": 0.2}, "faults.0.at: 30.01 s is not a multiple of the time step"),
        ({"type": "battery", "at": 60.0, "charge": 0.2}, "faults.0.at: 60 s is not within the run"),
        ({"type": "battery", "at": 3.0, "charge": 0.2, "end": 4.0}, "faults.0.end: only with health"),
        ({"type": "battery", "at": 3.0, "health": 0.2, "end": 2.0}, "faults.0.end: 2 s is not after the start, 3 s"),
        ({"type": "battery", "at": 3.0, "charge": 0.2, "vehicles": ["uav_3"]}, "no vehicle of the fleet is called"),
        (
            {"type": "rotor", "rotor": 0, "at": 3.0, "speed": 1.1},
            "faults.0.speed: 1.1 is out of range; allowed: 0 to 1",
        ),
        (
            {"type": "rotor", "rotor": 0, "at": 3.0, "speed": 0.5, "health": 0.5},
            "faults.0.health: a rotor that is stuck",
        ),
        ({"type": "battry", "at": 3.0}, "battery"),
    ],
)
def test_what_a_scenario_may_not_say_of_rotors_and_batteries(fault: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(scenario(None, fault))
    assert message in str(caught.value)
    given = scenario(None, {"type": "battery", "at": 3.0, "charge": 0.2})
    given["fleets"]["uav"]["battery"] = {"type": "given"}
    with pytest.raises(ScenarioError, match="a battery of type 'given' has no charge that it could lose"):
        load_scenario(given)


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


def test_radios_fail_where_they_are_injectable_and_links_anywhere() -> None:
    radio = {"preset": "sik_915", "path_loss": {"waves": 2}}
    world = load_scenario(scenario({"radio": True}, world={"radio": radio})).world()
    weak, names = injected(world, "radio", "weak", ["uav_1"], (50, 100), {"share": 0.25})
    slot = weak.fleets[0].radio_slot
    assert names == ("uav_1",)
    off, lost = slot.at(np.int32(50))
    assert (off.tolist(), lost.tolist()) == ([False] * 3, [0.0, 0.25, 0.0])
    assert slot.at(np.int32(49))[1].tolist() == slot.at(np.int32(100))[1].tolist() == [0.0] * 3
    silent, _ = injected(weak, "radio", "off", ["uav_1", "uav_2"], (60, 100), {})
    off, lost = silent.fleets[0].radio_slot.at(np.int32(60))
    assert (off.tolist(), lost.tolist()) == ([False, True, True], [0.0] * 3)
    well, _ = injected(silent, "radio", "ok", ["uav_1"], (0, 0), {})
    assert well.fleets[0].radio_slot.at(np.int32(60))[0].tolist() == [False, False, True]
    assert without_faults(well).fleets[0].radio_slot.at(np.int32(60))[0].tolist() == [False] * 3
    for kind, numbers, message in (
        ("drop", {}, "kind: 'drop' does not suit a radio; allowed: off, weak, ok"),
        ("weak", {}, "share: missing; kind 'weak' needs it, 0 to 1"),
        ("weak", {"share": 1.2}, "share: 1.2; allowed: 0 to 1"),
        ("off", {"share": 0.2}, "share: kind 'off' does not take it"),
    ):
        with pytest.raises(UsageError, match=message):
            injected(world, "radio", kind, None, (0, 9), numbers)
    bare = load_scenario(scenario(world={"radio": radio})).world()
    with pytest.raises(
        UsageError, match=r"'radio' is not injectable; write 'injectable: \{radio: true\}' under fleets.uav"
    ):
        injected(bare, "radio", "off", None, (0, 9), {})
    assert injected(bare, "link", "off", None, (0, 9), {}) == (bare, ("uav_0", "uav_1", "uav_2"))
