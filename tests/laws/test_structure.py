"""Laws of whole simulations: what else is in a world changes nobody's noise, and a run is a function of its seed.

Every law is about the five vehicles of the default scenario, flying on measurements in wind and turbulence for half a
second: long enough for the sky and the receivers to step twice.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.core.noise import Draw, Drawn, Key
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation
from qrsim.world.draws import draw_fleet, stream_keys
from qrsim.world.state import World
from small_worlds import noisy, simulate

SEED, TICKS, OBSERVED = 3, 25, 5
# The receiver draws one normal per satellite.
SATELLITES = 24


# Of a second of flight in single precision against double precision.
TOLERANCES = {"position_ned": 1e-4, "attitude": 1e-5, "velocity_ned": 1e-4, "wind_ned": 1e-5}


CHANGES: dict[str, dict[str, Any]] = {
    "nothing": {},
    "a vehicle more": {"vehicle_more": True},
    "a sensor less": {"without": ("gyroscope",)},
    "a fleet more": {"fleet_more": True},
    # The two that change no arithmetic of the fleet that is watched fly together, because each flight is compiled.
    "a fleet more and a sensor less": {"fleet_more": True, "without": ("gyroscope",)},
}
FLIGHTS = ["a vehicle more", "a fleet more and a sensor less"]


def parts(simulation: Simulation) -> dict[str, np.ndarray[Any, Any]]:
    """Return every array of the state that belongs to the first five pelicans, sensors by their name."""
    number = [fleet.name for fleet in simulation.world.fleets].index("pelicans")
    fleet, state = simulation.world.fleets[number], simulation.state.fleets[number]
    named: dict[str, Any] = {}
    for field, value in vars(state).items():
        if field in ("sensors", "readings", "true_readings"):
            for sensor, item in zip(fleet.sensor_names, value, strict=True):
                named[f"{field} {sensor}"] = item
        else:
            named[field] = value
    named["sky"] = simulation.state.sky
    found = {}
    for path, leaf in jax.tree_util.tree_leaves_with_path(named):
        name = jax.tree_util.keystr(path)
        found[name] = np.asarray(leaf) if name.startswith("['sky']") else np.asarray(leaf)[..., :OBSERVED]
    return found


@cache
def flown(change: str = "nothing", seed: int = SEED, precision: str = "float32") -> tuple[dict[str, Any], ...]:
    """Return the parts at the start, after one step and at the end of a flight; do not change them."""
    simulation = simulate(noisy(**CHANGES[change]), seed=seed, precision=precision)
    seen = [parts(simulation)]
    for ticks in (1, TICKS - 1):
        simulation.step(ticks=ticks)
        seen.append(parts(simulation))
    assert simulation.valid.all()
    return tuple(seen)


def assert_same_bits(found: dict[str, Any], expected: dict[str, Any]) -> None:
    for name, array in found.items():
        np.testing.assert_array_equal(array, expected[name], err_msg=name)


@cache
def drawing(change: str = "nothing") -> Any:
    """Return a function (key, tick) -> every normal that the pelicans are handed, by the name of its stream."""
    world: World = load_scenario(noisy(**CHANGES[change])).world()
    fleet = next(fleet for fleet in world.fleets if fleet.name == "pelicans")

    def draw(key: Key, tick: Any) -> dict[str, Any]:
        drawn = {}
        for name, noise in draw_fleet(world, fleet, stream_keys(fleet, key), tick).items():
            assert isinstance(noise, Draw | Drawn)
            rows = jnp.stack(noise.rows) if isinstance(noise, Drawn) else noise.normal_rows(SATELLITES)
            drawn[name] = rows[:, :OBSERVED]
        return drawn

    return draw


@pytest.mark.long
@pytest.mark.parametrize("change", ["a vehicle more", "a sensor less", "a fleet more"])
def test_no_normal_of_another_vehicle_changes(change: str) -> None:
    before, after = jax.jit(drawing()), jax.jit(drawing(change))
    for tick in (1, 12_345):
        old, new = (draw(Key.root(SEED), jnp.int32(tick)) for draw in (before, after))
        kept = set(old) & set(new)
        assert {"turbulence", "process", "gnss", "barometer", "attitude", "accelerometer"} <= kept
        assert_same_bits({name: new[name] for name in kept}, old)


def test_both_code_generators_draw_the_same_bits() -> None:
    """Simulation compiles large fleets with another one than small fleets, and a vehicle may be the one too many."""
    large = jax.jit(drawing())
    small = jax.jit(drawing(), compiler_options={"xla_cpu_use_fusion_emitters": False})
    for tick in (1, 12_345):
        assert_same_bits(small(Key.root(SEED), jnp.int32(tick)), large(Key.root(SEED), jnp.int32(tick)))


@pytest.mark.long
def test_the_normals_of_worlds_differ_and_are_the_same_bits_in_a_batch() -> None:
    """Three worlds in one program: two worlds of one seed, and a world of another seed."""
    keys = [Key.root(SEED), Key.root(SEED, 1), Key.root(SEED + 1)]
    together = jax.tree.map(lambda *part: jnp.stack(part), *keys)
    batch = jax.jit(jax.vmap(drawing(), in_axes=(0, None)))(together, jnp.int32(1))
    alone = jax.jit(drawing())
    for row, key in enumerate(keys):
        assert_same_bits({name: rows[row] for name, rows in batch.items()}, alone(key, jnp.int32(1)))
    everything = np.concatenate([np.asarray(rows).reshape(-1) for rows in batch.values()])
    # Two single-precision normals are equal with a chance of some 2e-8, any two of these 660 with 0.4 %.
    assert len(np.unique(everything)) == everything.size


@pytest.mark.parametrize("change", [FLIGHTS[0], *(pytest.param(each, marks=pytest.mark.long) for each in FLIGHTS[1:])])
def test_no_noise_process_of_another_vehicle_changes(change: str) -> None:
    """Drifts and range errors, which have memory, in flight; and the gusts as they start."""
    for before, after in zip(flown(), flown(change), strict=True):
        own = {name for name in after if "drift" in name or ".error." in name or name == "['sky'].range_error"}
        assert len(own) == 5, "barometer drift, three attitude errors, sky"
        assert_same_bits({name: after[name] for name in own}, before)
    gusts = {name: array for name, array in flown(change)[0].items() if name.startswith("['turbulence']")}
    assert len(gusts) == 3, "along, across and down"
    assert_same_bits(gusts, flown()[0])


def test_nothing_at_all_of_another_vehicle_changes_by_sensors_and_fleets() -> None:
    """Truth, gusts, commands, readings: every bit, for as long as it flies."""
    for before, after in zip(flown(), flown("a fleet more and a sensor less"), strict=True):
        assert len(after) > 50
        assert_same_bits(after, before)
        assert {name for name in before if name not in after} == {name for name in before if "gyroscope" in name}


def test_an_added_vehicle_changes_the_others_by_no_more_than_rounding() -> None:
    """A program for three vehicles may round its arithmetic otherwise than one for two; its noise it may not."""
    before, after = flown()[-1], flown("a vehicle more")[-1]
    for axis in "xyz":
        name = f"['vehicle'].position_ned.{axis}"
        # Single precision at some 30 m is 2e-6 m; 25 steps add a few of those.
        np.testing.assert_allclose(after[name], before[name], rtol=0.0, atol=2e-5)


def test_the_same_seed_is_the_same_run_and_another_seed_another() -> None:
    again = simulate(noisy(), seed=SEED)
    again.step(ticks=TICKS)
    assert_same_bits(parts(again), flown()[-1])
    other = flown(seed=SEED + 1)
    for start, end in ((0, 0), (-1, -1)):
        for name, array in flown()[start].items():
            if "drift" in name or ".error." in name or "gust" in name or "range_error" in name:
                assert not np.any(array == other[end][name]), name


def test_many_ticks_in_one_call_are_single_steps() -> None:
    one_by_one = simulate(noisy(), seed=SEED)
    for _ in range(50):
        one_by_one.step()
    at_once = simulate(noisy(), seed=SEED)
    at_once.step(ticks=50)
    assert at_once.tick == one_by_one.tick == 50
    assert_same_bits(parts(at_once), parts(one_by_one))


def gusty() -> Simulation:
    """Return one vehicle with process noise and sensors of two periods: enough to tell two programs apart."""
    simulation = qrsim.load("hover_ideal", seed=SEED, overrides=["fleets.pelicans.vehicle.process_noise=0.5"])
    simulation.reset()
    return simulation


def test_a_record_has_every_state_on_the_way() -> None:
    stepped, recorded = gusty(), gusty()
    stepped.step(ticks=3)
    recorded.step(ticks=3)
    history = recorded.record(TICKS)
    np.testing.assert_array_equal(history.ticks, np.arange(4, 4 + TICKS))
    np.testing.assert_allclose(history.time, 0.02 * history.ticks, rtol=1e-15)
    for row in range(TICKS):
        stepped.step()
        for (path, kept), (_, now) in zip(
            jax.tree_util.tree_leaves_with_path(history.state),
            jax.tree_util.tree_leaves_with_path(stepped.state),
            strict=True,
        ):
            np.testing.assert_array_equal(kept[row], now, err_msg=f"{jax.tree_util.keystr(path)} in row {row}")
    assert recorded.tick == stepped.tick
    recorded.step(ticks=5)
    stepped.step(ticks=5)
    assert_same_bits(parts(recorded), parts(stepped))
    assert np.abs(stepped.truth.rates_body).min() > 0.0, "there is noise"


def test_a_reset_is_the_start_again() -> None:
    simulation = simulate(noisy(), seed=SEED)
    simulation.step(ticks=TICKS)
    first = simulation.reset()
    assert (simulation.tick, simulation.time, first.time) == (0, 0.0, 0.0)
    assert_same_bits(parts(simulation), flown()[0])
    simulation.step(ticks=TICKS)
    assert_same_bits(parts(simulation), flown()[-1])
    simulation.reset(seed=SEED + 1)
    assert simulation.seed == SEED + 1
    assert_same_bits(parts(simulation), flown(seed=SEED + 1)[0])
    simulation.reset()
    assert simulation.seed == SEED + 1, "a seed stays until another is given"


@pytest.mark.long
def test_single_and_double_precision_agree() -> None:
    """For a second of flight with the same noise: to 0.1 mm, 1e-5 rad and 0.1 mm/s (found: a tenth of that)."""
    single, double = (simulate(noisy(), seed=SEED, precision=precision) for precision in ("float32", "float64"))
    for simulation in (single, double):
        simulation.step(ticks=50)
    # Positions have two parts in single precision, and are shown in double.
    assert (single.truth.attitude.dtype, double.truth.attitude.dtype) == (np.float32, np.float64)
    assert single.state.fleets[0].vehicle.position_ned.x.dtype == np.float32
    for quantity, tolerance in TOLERANCES.items():
        error = np.abs(getattr(single.truth, quantity) - getattr(double.truth, quantity)).max()
        assert error < tolerance, quantity
