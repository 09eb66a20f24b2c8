"""What a fault makes of a reading, and when; what a scenario may say of faults."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.errors import ScenarioError
from qrsim.models.sensors.barometer import BarometerReading
from qrsim.models.sensors.faults import Fault
from qrsim.scenarios.scenario import load_scenario

NOW = BarometerReading(np.array([1.0, 2.0]), np.array([0.1, 0.2]))  # type: ignore[arg-type]
BEFORE = BarometerReading(np.array([9.0, 9.0]), np.array([0.9, 0.9]))  # type: ignore[arg-type]


def fault(kind: Any, field: str = "", bias: float = 0.0) -> Fault:
    return Fault(
        start_tick=jnp.int32(10),
        end_tick=jnp.int32(20),
        affected=jnp.array([True, False]),
        bias=jnp.float32(bias),
        sensor="barometer",
        kind=kind,
        field=field,
    )


@pytest.mark.parametrize(("tick", "active"), [(9, False), (10, True), (19, True), (20, False)])
def test_lasts_from_start_to_end_for_those_affected(tick: int, active: bool) -> None:
    delivered = fault("lost").apply(NOW, BEFORE, jnp.int32(tick))
    np.testing.assert_array_equal(np.isnan(delivered.height), [active, False])
    assert delivered.height[1] == 2.0


def test_frozen_repeats_what_it_passed_on_before() -> None:
    delivered = fault("frozen").apply(NOW, BEFORE, jnp.int32(15))
    np.testing.assert_array_equal(delivered.height, [9.0, 2.0])


def test_biased_adds_to_one_field_only() -> None:
    delivered = fault("biased", "height", 5.0).apply(NOW, BEFORE, jnp.int32(15))
    np.testing.assert_array_equal(delivered.height, [6.0, 2.0])
    np.testing.assert_array_equal(delivered.height_rate, NOW.height_rate)


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
    lost, empty = "lost, by a fault of the scenario", "frozen, by a fault of the scenario, while it had no reading"
    assert reasons[0.08] == ["", ""]
    assert reasons[0.1] == [lost, lost]
    assert reasons[0.2] == [empty, lost]
    assert reasons[0.4] == [empty, ""]
    assert reasons[0.6] == ["", ""]


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
        ({"bias": 1.0}, "faults.0.bias: only for kind 'biased', not 'lost'"),
        ({"kind": "biased", "bias": 1.0, "field": "position_ned.w"}, "the sensor does not report 'position_ned.w'"),
        ({"kind": "biased", "field": "position_ned.x"}, "faults.0.bias: missing"),
        ({"kind": "biassed"}, "did you mean 'biased'?"),
    ],
)
def test_bad_input(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        qrsim.load(scenario({"sensor": "gnss", "kind": "lost", "start": 1.0} | change))
    assert message in str(caught.value)
