"""What a fault makes of a reading, and when; what a scenario may say of faults."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.errors import ScenarioError
from qrsim.models.barometer import BarometerReading
from qrsim.models.faults import Fault

NOW = BarometerReading(jnp.array([1.0, 2.0]), jnp.array([0.1, 0.2]))
BEFORE = BarometerReading(jnp.array([9.0, 9.0]), jnp.array([0.9, 0.9]))


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


def test_frozen_repeats_what_was_delivered_before() -> None:
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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sensor": "gns"}, "faults.0.sensor: no sensor is called 'gns'; did you mean 'gnss'?"),
        ({"end": 0.5}, "faults.0.end: 0.5 s is not after the start, 1 s"),
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
