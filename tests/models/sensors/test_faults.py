"""What a fault makes of a reading, and when; what a scenario may say of faults."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import replace
from qrsim.errors import ScenarioError, UsageError
from qrsim.models.sensors.barometer import BarometerReading
from qrsim.models.sensors.fault_numbers import empty_slot, fault_numbers, kind_of
from qrsim.models.sensors.faults import Fault, FaultMemory
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.injections import _sensor_fault

NOW = BarometerReading(np.float32([1.0, 2.0]), np.float32([0.1, 0.2]))  # type: ignore[arg-type]
BEFORE = BarometerReading(np.float32([9.0, 9.0]), np.float32([0.9, 0.9]))  # type: ignore[arg-type]


FIELDS = ("height", "height_rate")


def fault(kind: Any, fields: tuple[str, ...] = FIELDS, ticks: int = 1, **numbers: float) -> Fault:
    return Fault(
        start_tick=jnp.int32(10),
        end_tick=jnp.int32(20),
        affected=jnp.array([True, False]),
        numbers=fault_numbers(kind, numbers, ("height",), fields, 0.02, ticks),
        sensor="barometer",
        kind=kind_of(kind),
        fields=fields,
        ticks=ticks,
    )


def applied(kind: str, tick: int, **numbers: float) -> BarometerReading:
    draw = Draw(Key.root(3).stream("fault", jnp.arange(2, dtype=jnp.uint32)), jnp.int32(tick), jnp.float32(0.0))
    return fault(kind, **numbers).apply(NOW, FaultMemory(BEFORE), jnp.int32(tick), draw)[0]


@pytest.mark.parametrize(("tick", "active"), [(9, False), (10, True), (19, True), (20, False)])
def test_lasts_from_start_to_end_for_those_affected(tick: int, active: bool) -> None:
    delivered = applied("lost", tick)
    np.testing.assert_array_equal(np.isnan(delivered.height), [active, False])
    assert delivered.height[1] == 2.0


@pytest.mark.parametrize(
    ("kind", "numbers", "height"),
    [
        ("frozen", {}, 9.0),
        ("biased", {"bias": 5.0}, 6.0),
        ("wrong", {"scale": 3.0, "bias": 5.0}, 8.0),
        # Five ticks of 0.02 s after its start.
        ("drift", {"rate": 10.0}, 2.0),
        ("drift", {"rate": 10.0, "limit": 0.25}, 1.25),
        ("drift", {"rate": -10.0, "limit": 0.25}, 0.75),
        # Of 0.04 s with readings and 0.06 s without, the sixth tick is the first of the second round.
        ("intermittent", {"on": 0.04, "off": 0.06}, 1.0),
        ("intermittent", {"on": 0.02, "off": 0.02}, math.nan),
        # The sixth reading since its start.
        ("slow", {"every": 5}, 1.0),
        ("slow", {"every": 6}, 9.0),
    ],
)
def test_what_a_fault_makes_of_one_field(kind: str, numbers: dict[str, float], height: float) -> None:
    delivered = applied(kind, 15, **numbers)
    np.testing.assert_allclose(delivered.height, [height, 2.0], rtol=1e-6)
    if kind in ("biased", "wrong", "drift"):
        np.testing.assert_array_equal(delivered.height_rate, NOW.height_rate)


def drawn(kind: str, many: int = 10_000, ticks: int = 1, tick: int = 15, **numbers: float) -> np.ndarray:
    """Return the heights of many sensors, of which all say 1 m."""
    one = replace(fault(kind, ticks=ticks, **numbers), affected=jnp.ones(many, bool))
    stream = Key.root(3).stream("a/barometer/fault", jnp.arange(many, dtype=jnp.uint32))
    draw = Draw(stream, jnp.int32(tick), jnp.float32(0.0))
    reading = BarometerReading(jnp.ones(many), jnp.zeros(many))
    return np.asarray(one.apply(reading, one.begin(reading), jnp.int32(tick), draw)[0].height)


def test_random_kinds_have_the_law_that_is_asked_for() -> None:
    # Three standard errors of 10 000 readings.
    noisy, garbage, lost = drawn("noisy", std=2.0), drawn("garbage", range=3.0), drawn("intermittent", share=0.5)
    np.testing.assert_allclose([noisy.mean() - 1.0, noisy.std()], [0.0, 2.0], atol=0.06)
    np.testing.assert_allclose([garbage.mean(), garbage.std()], [0.0, math.sqrt(3.0)], atol=0.06)
    assert np.abs(garbage).max() <= 3.0
    assert np.isnan(lost).mean() == pytest.approx(0.5, abs=0.015)


def test_faults_draw_independently_but_for_those_that_are_one() -> None:
    """By the tick at which they begin, and by their order where that is the same; three standard errors."""
    stream = Key.root(3).stream("a/barometer/fault", jnp.arange(10_000, dtype=jnp.uint32))
    reading = BarometerReading(jnp.zeros(10_000), jnp.zeros(10_000))
    rows = []
    for start, order in ((10, 0), (11, 0), (10, 1), (10, 0)):
        one = replace(
            fault("noisy", std=1.0), start_tick=jnp.int32(start), affected=jnp.ones(10_000, bool), order=order
        )
        draw = Draw(stream, jnp.int32(15), jnp.float32(0.0))
        rows.append(np.asarray(one.apply(reading, None, jnp.int32(15), draw)[0].height))
    together = np.corrcoef(rows)
    assert np.abs(together[0, 1:3]).max() < 0.03
    assert abs(together[1, 2]) < 0.03
    np.testing.assert_array_equal(rows[0], rows[3])
    pair = [{"sensor": "baro", "kind": "noisy", "field": "height", "std": 1.0, "start": 1.0} for _ in range(3)]
    pair[1] |= {"vehicles": ["a_0"]}
    pair[2] |= {"kind": "garbage", "range": 2.0, "std": None}
    assert [one.order for one in load_scenario(scenario(*pair)).world().fleets[0].faults] == [0, 1, 0]


def test_what_is_drawn_for_a_reading_stays_while_it_is_held() -> None:
    first, held, next_one = (drawn("noisy", 4, ticks=5, tick=tick, std=1.0) for tick in (15, 19, 20 - 5))
    np.testing.assert_array_equal(first, held)
    np.testing.assert_array_equal(first, next_one)
    assert (drawn("noisy", 4, ticks=5, tick=10, std=1.0) != first).all()


CASES: list[tuple[str, dict[str, float]]] = [
    ("off", {}), ("stuck", {}), ("wrong", {"bias": 0.3, "scale": 1.1}), ("drift", {"rate": 0.5, "limit": 0.1}),
    ("noisy", {"std": 0.7}), ("garbage", {"range": 2.0}), ("slow", {"every": 3}), ("delayed", {"by": 0.2}),
    ("intermittent", {"share": 0.5}),
]  # fmt: skip


def test_a_slot_makes_the_same_of_readings_as_faults_of_a_scenario() -> None:
    """To the bit, in readings of every fifth tick: each kind on a vehicle of its own."""
    count, slot = len(CASES), empty_slot(len(CASES), "barometer", FIELDS, 5, 0.02, 2)
    for i, (kind, numbers) in enumerate(CASES):
        slot = _sensor_fault(slot, kind, np.arange(count) == i, (12, 70), numbers | field_of(kind), 0.02)
    stream = Key.root(3).stream("a/barometer/fault", jnp.arange(count, dtype=jnp.uint32))
    heights = np.random.default_rng(1).normal(size=(20, 2, count)).astype(np.float32)

    def fly(one: Any) -> Callable[[Any], Any]:
        def tick(memory: Any, number: Any) -> Any:
            now = jnp.asarray(heights)[number // 5]
            draw = Draw(stream, number, jnp.float32(0.0))
            delivered, memory = one.apply(BarometerReading(now[0], now[1]), memory, number, draw)
            return memory, jnp.stack([delivered.height, delivered.height_rate])

        start = one.begin(BarometerReading(jnp.asarray(heights)[0, 0], jnp.asarray(heights)[0, 1]))
        return jax.jit(lambda numbers: jax.lax.scan(tick, start, numbers)[1])

    said = np.asarray(fly(slot)(jnp.arange(1, 100)))
    for i, (kind, numbers) in enumerate(CASES):
        only = ("height",) if field_of(kind) else ()
        one = Fault(
            jnp.int32(12), jnp.int32(70), jnp.arange(count) == i,
            fault_numbers(kind, numbers, only, FIELDS, 0.02, 5), "barometer", FIELDS, 5, 0.02,
            2 if kind == "delayed" else 0, only, kind_of(kind),
        )  # fmt: skip
        np.testing.assert_array_equal(said[..., i], np.asarray(fly(one)(jnp.arange(1, 100)))[..., i], err_msg=kind)
    # The kinds differ from what was true, and after their end nothing is wrong any more.
    true = np.repeat(heights, 5, axis=0)[1:, 0]
    assert all((said[12:69, 0, i] != true[12:69, i]).any() for i in range(count))
    np.testing.assert_array_equal(said[75:, 0], true[75:])
    # Delayed by two readings.
    np.testing.assert_array_equal(said[30:69, 0, 7], true[20:59, 7])


def field_of(kind: str) -> dict[str, Any]:
    return {"field": "height"} if kind in ("wrong", "drift", "noisy", "garbage") else {}


def scenario(*faults: dict[str, Any]) -> dict[str, Any]:
    return {
        "name": "faulty",
        "duration": 4.0,
        "fleets": {
            "a": {
                "controller": {"type": "waypoint"},
                "sensors": {
                    "gnss": {"type": "ideal_gnss"},
                    "baro": {"type": "ideal_barometer"},
                    "attitude": {"type": "ideal_attitude"},
                },
                "faults": list(faults),
                "vehicles": [{"position_ned": [0.0, 10.0 * i, -10.0]} for i in range(2)],
            }
        },
    }


def test_a_run_with_faults_goes_on_and_recovers() -> None:
    simulation = qrsim.load(
        scenario(
            {"sensor": "gnss", "kind": "lost", "start": 1.0, "end": 2.0, "vehicles": ["a_0"]},
            {"sensor": "baro", "kind": "biased", "field": "height", "bias": 3.0, "start": 1.0},
        )
    )
    simulation.reset()
    reading = simulation.step(ticks=75)
    np.testing.assert_array_equal(np.isnan(reading.gnss.position_ned).all(axis=1), [True, False])
    np.testing.assert_array_equal(reading.gnss.fix_type, [0, 3])
    np.testing.assert_allclose(reading.baro.height + simulation.truth.position_ned[:, 2], 3.0, atol=1e-4)
    reading = simulation.step(ticks=75)
    assert np.isfinite(reading.gnss.position_ned).all()
    assert simulation.valid.all()


def test_of_several_faults_each_acts_on_what_the_one_before_it_passes_on() -> None:
    """In the order given, whatever began first: a bias is added once to what is frozen, and NaN can be frozen."""
    frozen = {"kind": "frozen", "start": 0.2, "end": 0.6}
    up = {"sensor": "baro", "kind": "biased", "field": "height", "bias": 1.0}
    content = scenario(
        {"sensor": "baro", **frozen},
        up | {"start": 0.1},
        {"sensor": "gnss", "kind": "lost", "start": 0.1, "end": 0.4},
        {"sensor": "gnss", **frozen, "vehicles": ["a_0"]},
        up | {"sensor": "other", "start": 0.0},
        {"sensor": "other", "kind": "frozen", "start": 0.0},
        up | {"sensor": "other", "start": 0.3},
    )
    fleet = content["fleets"]["a"]
    # Of sensors with the same fields the controller is fed by the first.
    fleet["sensors"]["other"] = {"type": "ideal_barometer"}
    simulation = qrsim.load(content)
    start = simulation.reset().other.height
    height, biased, delivered, reasons = [], [], [], {}
    for _ in range(50):
        reading = simulation.step()
        height.append(-simulation.truth.position_ned[0, 2])
        biased.append(reading.baro.height[0])
        delivered.append(reading.other.height[0])
        reasons[round(reading.time, 2)] = reading.gnss.reasons
    assert len(set(height)) > 40, "it sinks a little at first"
    # Ticks 10 to 29 are frozen at what was true at tick 9; the bias is there from tick 5 on.
    expected = np.array(height)
    expected[9:29] = height[8]
    expected[4:] += 1.0
    np.testing.assert_allclose(biased, expected, rtol=0.0, atol=1e-5)
    # Frozen from the start with the bias before it, and from tick 15 on with the one after it too.
    np.testing.assert_allclose(start, -simulation.world.fleets[0].start.position_ned.z + 1.0, rtol=1e-6)
    np.testing.assert_allclose(delivered, np.where(np.arange(1, 51) < 15, start[0], start[0] + 1.0), rtol=1e-6)
    # a_0 stays without a fix for as long as it is frozen, a_1 for as long as it is lost.
    lost, empty = "off, by a fault of the scenario", "stuck, by a fault of the scenario, while it had no reading"
    assert reasons[0.08] == ["", ""]
    assert reasons[0.1] == [lost, lost]
    assert reasons[0.2] == [empty, lost]
    assert reasons[0.4] == [empty, ""]
    assert reasons[0.6] == ["", ""]


def test_faults_of_late_sensors_act_on_what_is_delivered() -> None:
    """A barometer of 0.1 s, delivered 0.06 s late: what is delivered from 0.2 s on is lost, until 0.4 s."""
    content = scenario(
        {"sensor": "baro", "kind": "off", "start": 0.2, "end": 0.4},
        {"sensor": "other", "kind": "noisy", "field": "height", "std": 5.0, "start": 0.2, "end": 0.4},
        {"sensor": "other", "kind": "delayed", "by": 0.1, "start": 0.5},
        {"sensor": "third", "kind": "drift", "field": "height", "rate": 10.0, "start": 0.2, "end": 0.4},
    )
    late = {"type": "ideal_barometer", "period": 0.1, "delay": 0.6}
    content["fleets"]["a"]["sensors"] |= {"baro": late, "other": late, "third": late}
    simulation = qrsim.load(content)
    simulation.reset()
    lost, noisy, drifting, height = [], [], [], []
    for _ in range(45):
        reading = simulation.step()
        lost.append(bool(np.isnan(reading.baro.height[0])))
        noisy.append(float(reading.other.height[0]))
        drifting.append(float(reading.third.height[0]))
        height.append(-float(simulation.truth.position_ned[0, 2]))
    # Row k is tick k + 1: ticks 10 to 19; tick 13 has the reading of tick 10, and tick 18 that of tick 15.
    assert np.flatnonzero(lost).tolist() == list(range(9, 19))
    # A drift is that of the time at which a reading was taken: none before it began, 1 m after 0.1 s.
    np.testing.assert_allclose(
        [drifting[9], drifting[12], drifting[17]], [height[4], height[9], height[14] + 1.0], atol=1e-4
    )
    # One draw for each reading, held until the next one comes.
    assert len({*noisy[9:12]}) == len({*noisy[12:17]}) == len({*noisy[17:19]}) == 1
    assert len({noisy[9] - height[4], noisy[12] - height[9], noisy[17] - height[14]}) == 3
    assert min(abs(noisy[9] - height[4]), abs(noisy[12] - height[9]), abs(noisy[17] - height[14])) > 0.1
    np.testing.assert_allclose(noisy[19:22], height[14], atol=1e-4)
    np.testing.assert_allclose(noisy[22:24], height[19], atol=1e-4)
    # From tick 25 on one more reading late.
    np.testing.assert_allclose(noisy[24:27], height[14], atol=1e-4)
    np.testing.assert_allclose([noisy[27], noisy[32], noisy[37]], [height[19], height[24], height[29]], atol=1e-4)


def test_noise_can_be_a_multiple_of_the_sensor_s_own() -> None:
    """Of 0.3 m, three times as much is sqrt(8) of it added; a sensor that states none is refused."""
    content = scenario({"sensor": "baro", "kind": "noisy", "field": "height", "times": 3.0, "start": 1.0})
    content["fleets"]["a"]["sensors"]["baro"] = {"type": "barometer", "white_std": 0.3}
    (built,) = load_scenario(content, quiet=True).world().fleets[0].faults
    np.testing.assert_allclose(built.numbers.amounts, [0.3 * math.sqrt(8.0), 0.0], rtol=1e-6)
    content["fleets"]["a"] |= {"injectable": "all", "faults": []}
    simulation = qrsim.load(content)
    simulation.reset()
    simulation.inject("baro", "noisy", field="height", times=3.0)
    (slot,) = [slot for slot in simulation.world.fleets[0].fault_slots if slot.sensor == "baro"]
    np.testing.assert_array_equal(slot.numbers.amounts[0], np.float32(built.numbers.amounts[0]))
    for sensor, field, message in (
        ("gnss", "position_ned", "times: the sensor states no white noise of 'position_ned'; give std"),
        ("baro", "height_rate", "times: the sensor states no white noise of 'height_rate', only of height; give std"),
    ):
        with pytest.raises(UsageError, match=message):
            simulation.inject(sensor, "noisy", field=field, times=2.0)
    with pytest.raises(UsageError, match="std: kind 'noisy' needs std or times, one of the two"):
        simulation.inject("baro", "noisy", field="height", times=2.0, std=1.0)
    with pytest.raises(UsageError, match=r"times: 0\.5; allowed: 1 to 1e"):
        simulation.inject("baro", "noisy", field="height", times=0.5)


def test_only_what_is_frozen_has_a_memory() -> None:
    simulation = qrsim.load(scenario({"sensor": "baro", "kind": "lost", "start": 1.0}))
    simulation.reset()
    assert simulation.state.fleets[0].passed_on == (None,)
    assert simulation.state.fleets[0].true_readings[0] is None


def test_an_end_beyond_the_run_is_its_end() -> None:
    for end in (4.0, 1e9, 1e300):
        content = scenario({"sensor": "gnss", "kind": "lost", "start": 3.98, "end": end})
        (built,) = load_scenario(content).world().fleets[0].faults
        assert built.start_tick == 199
        assert built.end_tick == min(round(end / 0.02), 2**31 - 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sensor": "gns"}, "faults.0.sensor: no sensor is called 'gns'; did you mean 'gnss'?"),
        ({"end": 0.5}, "faults.0.end: 0.5 s is not after the start, 1 s"),
        (
            {"start": 1e9},
            "faults.0.start: 1e+09 s is not within the run; allowed: from 0 s to before its end at 4 s",
        ),
        ({"start": 4.0}, "faults.0.start: 4 s is not within the run; allowed: from 0 s to before its end at 4 s"),
        ({"start": 0.41}, "faults.0.start: 0.41 s is not a multiple of the time step 0.02 s"),
        ({"end": 1.01}, "faults.0.end: 1.01 s is not a multiple of the time step 0.02 s"),
        ({"end": 1.7e308}, "faults.0.end: 1.7e+308 s is not a multiple of the time step 0.02 s"),
        ({"vehicles": ["a_7"]}, "faults.0.vehicles: no vehicle of the fleet is called 'a_7'"),
        ({"bias": 1.0}, "faults.0.bias: only for kind 'wrong', not 'lost'"),
        ({"kind": "biased", "bias": 1.0, "field": "position_ned.w"}, "the sensor does not report 'position_ned.w'"),
        ({"kind": "biased", "field": "position_ned.x"}, "faults.0.bias: missing"),
        ({"kind": "biassed"}, "did you mean 'biased'?"),
        ({"kind": "noisy", "field": "position_ned.x"}, "faults.0.std: kind 'noisy' needs std or times, one of the two"),
        ({"kind": "noisy", "field": "position_ned.x", "times": 2}, "faults.0.times: the sensor states no white noise"),
    ],
)
def test_bad_input(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        qrsim.load(scenario({"sensor": "gnss", "kind": "lost", "start": 1.0} | change))
    assert message in str(caught.value)
