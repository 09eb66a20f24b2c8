"""What must change no fix, among buildings, near jammers and with a base station: laws of the sensor gnss."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.by_numpy import by_numpy

import qrsim
from qrsim.core.noise import Draw, Stream
from qrsim.core.vectors import Vec3
from qrsim.scenarios.scenario import load_scenario

PLACES = ((0.0, 0.0, -3.0), (30.0, 0.0, -12.0), (60.0, 1.0, -30.0))
STREET = [
    {"type": "box", "x_min": -100, "x_max": 100, "y_min": 8, "y_max": 24, "z_min": -25},
    {"type": "prism", "corners_ned": [[-100, -24], [100, -24], [100, -8], [-100, -8]], "z_min": -25},
]
JAMMER = {"kind": "jammer", "position_ned": [700.0, 0.0, -2.0], "power_w": 0.0005, "start": 2.0, "end": 8.0}
FAR_AWAY = {"type": "box", "x_min": 900, "x_max": 910, "y_min": 900, "y_max": 910, "z_min": -6}
TICKS = 300
# The code generator that compiles these programs in half the time.
QUICKLY = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}


def scenario(count: int = 3, **world: Any) -> dict[str, Any]:
    """Return rovers with a base station in a street, some of them jammed for a while."""
    area = {"type": "box", "x_min": -150, "x_max": 150, "y_min": -150, "y_max": 150, "z_min": -120}
    fleet = {
        "sensors": {"gnss": {"type": "gnss", "preset": "f9p_rtk", "first_fix": "fixed", "per_satellite": True}},
        "controller": {"type": "cascade", "feed": "truth"},
        "vehicles": [{"position_ned": list(place)} for place in PLACES[:count]],
    }
    base: dict[str, Any] = {"area": area, "obstacles": STREET, "base_station": {"position_ned": [-90, -90, -30]}}
    base["interference"] = [JAMMER]
    return {"name": "x", "duration": 60.0, "world": {**base, **world}, "fleets": {"rovers": fleet}}


def flown(content: dict[str, Any], **how: Any) -> Any:
    """Return the last reading after some seconds."""
    simulation = qrsim.load(content, seed=4, **how)
    simulation.reset()
    simulation.step(ticks=TICKS)
    return simulation.reading.gnss, simulation


@pytest.fixture(scope="module")
def plain() -> Any:
    return flown(scenario())


@pytest.mark.long
class TestFlown:
    def test_it_is_a_hard_case(self, plain: Any):
        gnss, simulation = plain
        assert gnss.satellites_blocked[0] + gnss.satellites_reflected[0] > 8.0
        assert ((gnss.jamming > 0.3) & (gnss.jamming < 1.0)).all()
        assert gnss.fix_type[2] > 4.0
        state = np.asarray(gnss.satellite_state)
        np.testing.assert_array_equal((state == 2.0).sum(axis=1), gnss.satellites_reflected)
        np.testing.assert_array_equal((state == 3.0).sum(axis=1), gnss.satellites_blocked)
        assert (state[2] != 2.0).all()
        assert np.isfinite(simulation.truth.position_ned).all()

    def test_another_vehicle_changes_nothing(self, plain: Any):
        gnss, _ = flown(scenario(2))
        np.testing.assert_array_equal(gnss.position_ned, plain[0].position_ned[:2])
        np.testing.assert_array_equal(gnss.satellite_state, plain[0].satellite_state[:2])

    def test_what_is_out_of_sight_or_over_or_without_power_changes_nothing(self, plain: Any):
        """A building, and jammers; in one world, which takes seconds to compile."""
        quiet = {**JAMMER, "power_w": 0.0, "start": 0.0}
        late = {**JAMMER, "start": 30.0, "end": 40.0}
        gnss, _ = flown(scenario(obstacles=[*STREET, FAR_AWAY], interference=[JAMMER, quiet, late]))
        np.testing.assert_array_equal(gnss.position_ned, plain[0].position_ned)

    def test_it_resumes_to_the_bit_from_any_tick(self, plain: Any):
        gnss, simulation = plain
        simulation.reset()
        for ticks in (7, 96, 44):
            simulation.step(ticks=ticks)
            simulation.load(simulation.save())
        simulation.step(ticks=TICKS - 147)
        np.testing.assert_array_equal(simulation.reading.gnss.position_ned, gnss.position_ned)
        np.testing.assert_array_equal(simulation.reading.gnss.fix_type, gnss.fix_type)

    def test_single_precision_is_good_to_millimetres_above_the_roofs(self, plain: Any):
        gnss, _ = flown(scenario(), precision="float64")
        assert np.abs(gnss.position_ned[2] - plain[0].position_ned[2]).max() < 2e-3


@pytest.mark.long
def test_the_order_of_receivers_and_how_they_are_compiled_change_nothing() -> None:
    """Receivers of the same numbers at the same places, in another order; compiled, and one operation at a time."""
    world = load_scenario(scenario()).world()
    simulation = qrsim.load(scenario(), seed=4)
    simulation.reset()
    sensor, sky = world.fleets[0].sensors[0], jax.tree.map(jnp.asarray, simulation.state.sky)

    def given(place: Vec3, ids: Any, tick: Any) -> Any:
        draw = Draw(Stream(jnp.uint32(3), jnp.uint32(5), ids), tick, place.x[0])
        return draw, place, place * 0.0, sky, None, None, world.skyline

    def init(place: Vec3, ids: Any) -> Any:
        return sensor.init(*given(place, ids, jnp.uint32(0)))

    def step(place: Vec3, ids: Any, tick: Any, state: Any) -> Any:
        return sensor.step(state, *given(place, ids, tick))

    def readings(order: list[int], run: Callable[..., Any]) -> Any:
        place = Vec3(*np.asarray([PLACES[i] for i in order], np.float32).T)  # type: ignore[arg-type]
        ids = np.asarray(order, np.uint32)
        state, reading = run(init)(place, ids)
        for tick in (10, 20, 30):
            state, reading = run(step)(place, ids, np.uint32(tick), state)
        return reading.position_ned.stack()

    def by_operation(function: Any) -> Any:
        return lambda *arguments: by_numpy(function, [arguments])[0]

    first, other = (readings(order, by_operation) for order in ([0, 1, 2], [2, 0, 1]))
    np.testing.assert_array_equal(np.asarray(first)[[2, 0, 1]], other)
    programs = {function: jax.jit(function, compiler_options=QUICKLY) for function in (init, step)}
    compiled, turned = (readings(order, programs.__getitem__) for order in ([0, 1, 2], [2, 0, 1]))
    np.testing.assert_array_equal(np.asarray(compiled)[[2, 0, 1]], turned)
    np.testing.assert_allclose(compiled, first, atol=1e-3)
