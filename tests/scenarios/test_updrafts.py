"""What a scenario may not ask of updrafts, what it is warned of, and that worlds feel them."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import qrsim
from qrsim.errors import ScenarioError
from qrsim.models.atmosphere.thermals import Thermals
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation
from qrsim.view.air import air_at, has_a_plane

AREA = "world.area={type: box, x_min: -600, x_max: 600, y_min: -600, y_max: 600, z_min: -900}"
THERMALS, RIDGE = "world.updrafts=[{type: thermals", "world.updrafts=[{type: ridge_lift}]"
WAKES = "world.updrafts=[{type: building_wakes}]"
MAST = "world.obstacles=[{type: cylinder, x: 50, y: 0, radius: 3, z_min: -30}]"


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ([f"{THERMALS}, w_star: 0}}]"], "world.updrafts.0.w_star: 0 is out of range; allowed: above 0"),
        ([f"{THERMALS}, w_star: -2}}]"], "world.updrafts.0.w_star: -2 is out of range; allowed: above 0"),
        ([f"{THERMALS}, w_star: .nan}}]"], "world.updrafts.0.w_star: nan is not a finite number"),
        ([f"{THERMALS}, places_ned: [[0, .nan]]}}]"], "world.updrafts.0.places_ned.0.1: nan is not a finite number"),
        ([f"{THERMALS}, z_i: 90}}]"], "world.updrafts.0.z_i: 90 is out of range; allowed: 100 to 8000"),
        ([f"{THERMALS}, count: 1001}}]"], "world.updrafts.0.count: 1001 is out of range; allowed: 0 to 1000"),
        ([f"{THERMALS}, count: 1000}}]"], "world.updrafts.0.count: 1000 thermals of z_i = 1200 m in world.area"),
        (
            [f"{THERMALS}, z_i: 6000}}]", "world.area={type: box, x_min: -200, x_max: 200}"],
            "world.updrafts.0.z_i: thermals of z_i = 6000 m are 918 m across, and world.area 400 m; allowed: z_i up to",
        ),
        ([f"{THERMALS}, places: [[0, 0]]}}]"], "no such parameter of 'thermals'; did you mean 'places_ned'?"),
        (["world.updrafts=[{type: thermal}]"], "updrafts.0.type: no such type 'thermal'; did you mean 'thermals'?"),
        ([RIDGE], "world.updrafts.0: 'ridge_lift' needs ground with slopes; world.ground is 'flat'; use one of type"),
        ([WAKES], "world.updrafts.0.least_height: no obstacle is 2 m high, so none has a wake; give world.obstacles"),
    ],
)
def test_faults_are_said_in_one_line(overrides: list[str], words: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario("hover_ideal", [AREA, *overrides], quiet=True)
    assert len(caught.value.problems) == 1
    assert words in caught.value.problems[0]


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (
            [f"{THERMALS}, z_i: 100, count: 1}}]", "fleets.pelicans.vehicles.0.position_ned=[0, 0, -150]"],
            "world.updrafts.0.z_i: 100 m, and fleets.pelicans.vehicles.0 is at 150 m or sent there; no air rises there",
        ),
        ([f"{THERMALS}, z_i: 200, count: 300}}]"], "world.updrafts.0: 300 thermals, all computed for every vehicle"),
        ([WAKES, MAST, "world.wind=calm"], "world.updrafts.0: 'building_wakes' does nothing without a wind; world.win"),
    ],
)
def test_what_does_nothing_is_warned_of(overrides: list[str], words: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_scenario("hover_ideal", [AREA, *overrides])
    assert [words in str(each.message) for each in caught] == [True]


def held(**parts: Any) -> dict[str, Any]:
    """Return the parts of points that stay at 100 m, a kilometre of them to the north."""
    box = {"type": "box", "x_min": -1000.0, "x_max": 1000.0, "y_min": -1000.0, "y_max": 1000.0, "z_min": -900.0}
    points = [[float(north), 0.0, -100.0] for north in range(-900, 901, 100)]
    still = {"vehicle": {"type": "fixed_point"}, "controller": {"type": "none"}, "guidance": {"type": "none"}}
    return {"area": box, "vehicles": points, "sensors": {}, "duration": 60.0, **still, **parts}


FEW = [{"type": "thermals", "w_star": 3.0, "z_i": 2500.0, "count": 20}]
WIND = {"type": "log_shear", "speed_20ft": 5.0, "wind_from_deg": 180.0}


@pytest.mark.long
def test_each_episode_has_thermals_of_its_own_and_a_batch_those_of_its_worlds() -> None:
    world = qrsim.make_world(**held(updrafts=FEW, wind=WIND))
    alone = []
    for number in range(3):
        simulation = Simulation(world, seed=7, number=number)
        simulation.reset()
        simulation.step(ticks=20)
        alone.append(simulation.truth.wind_ned[:, 2])
    assert len({row.tobytes() for row in alone}) == 3
    assert all(np.isfinite(row).all() and row.min() < 0.0 < row.max() for row in alone)
    again = Simulation(world, seed=7, number=1)
    again.reset()
    again.step(ticks=20)
    np.testing.assert_array_equal(again.truth.wind_ned[:, 2], alone[1])
    batch = qrsim.rollout(
        world, ticks=20, worlds=3, seed=7, record=lambda state: state.fleets[0].gust_ned.z, record_every=20
    )
    np.testing.assert_array_equal(np.asarray(batch.recorded)[:, -1], np.array(alone, np.float32))


@pytest.mark.long
def test_a_world_without_them_has_the_bits_that_it_had() -> None:
    """The stream of the places is one of its own: neither gusts nor anything else is drawn another way."""
    gusty = {"turbulence": {"type": "dryden_field"}, "wind": WIND}
    found = []
    for updrafts in ([], [{"type": "thermals", "z_i": 700.0, "count": 1, "sink": False}]):
        simulation = Simulation(qrsim.make_world(**held(updrafts=updrafts, **gusty)), seed=3)
        simulation.reset()
        simulation.step(ticks=20)
        found.append(simulation.truth.wind_ned)
    np.testing.assert_array_equal(found[0][:, :2], found[1][:, :2])


@pytest.mark.long
def test_the_air_in_a_plane_is_that_of_the_vehicles() -> None:
    world = qrsim.make_world(**held(updrafts=FEW, wind=WIND))
    assert has_a_plane(world)
    assert not has_a_plane(qrsim.make_world(**held(wind=WIND)))
    simulation = Simulation(world, seed=7)
    simulation.reset()
    simulation.step(ticks=20)
    state = simulation.state
    places = simulation.truth.position_ned.astype(np.float32)
    _, gust, _ = jax.jit(air_at)(world, state.drawn, state.field, np.int32(19), places)
    np.testing.assert_allclose(gust, np.asarray(state.fleets[0].gust_ned.stack()), atol=1e-5)


def test_a_number_of_them_can_be_drawn_and_an_object_can_be_given() -> None:
    ranges = [{"path": "world.updrafts.0.w_star", "low": 1.0, "high": 4.0}]
    given = Thermals(np.array([[0.0, 0.0]]), w_star=2.0, z_i=700.0)  # type: ignore[arg-type]
    scenario = qrsim.make_scenario(**held(updrafts=[given], ranges=ranges))
    assert scenario.spec.model_dump()["world"]["updrafts"][0]["places_ned"] == [[0.0, 0.0]]
    simulation = Simulation(scenario.world(), seed=1)
    simulation.reset()
    simulation.step(ticks=1)
    drawn = float(np.asarray(simulation.state.drawn[0]))
    assert 1.0 < drawn < 4.0
    # On the axis 100 m up: r2 = 35.991 m, r1/r2 = 0.17959, w = w* 0.142857^(1/3) (1 - 1.1/7) 3/1.21184 bell(0).
    peak = (1.0 / 7.0) ** (1.0 / 3.0) * (1.0 - 1.1 / 7.0) * 3.0 / (1.0 + 0.17959 + 0.17959**2)
    assert -simulation.truth.wind_ned[9, 2] == pytest.approx(drawn * peak, rel=1e-4)
    wide = [{"path": "world.updrafts.0.z_i", "low": 700.0, "high": 6000.0}]
    with pytest.raises(ScenarioError, match="at most"):
        qrsim.make_scenario(**held(updrafts=FEW, ranges=wide))
    with pytest.raises(ScenarioError, match="compiled into the program"):
        qrsim.make_scenario(**held(updrafts=FEW, ranges=[{"path": "world.updrafts.0.count", "low": 1, "high": 2}]))


@pytest.mark.long
def test_wind_rises_at_hills_and_falls_behind_buildings(tmp_path: Path) -> None:
    north, east = np.arange(-1000.0, 1001.0, 50.0), np.array([-1000.0, 1000.0])
    hill = 80.0 * np.exp(-((north / 200.0) ** 2))
    np.savez(tmp_path / "hill.npz", north=north, east=east, height=np.tile(hill[:, None], (1, 2)))
    ground = {"type": "dem", "file": str(tmp_path / "hill.npz"), "height_of_zero": 0.0}
    lift = qrsim.make_world(**held(updrafts=[{"type": "ridge_lift"}], ground=ground, wind=WIND))
    block = {"type": "box", "x_min": -25, "x_max": -15, "y_min": -40, "y_max": 40, "z_min": -140}
    wakes = qrsim.make_world(**held(updrafts=[{"type": "building_wakes"}], obstacles=[block], wind=WIND))
    found = []
    for world in (lift, wakes):
        simulation = Simulation(world, seed=1)
        simulation.reset()
        simulation.step(ticks=1)
        found.append(np.asarray(simulation.state.fleets[0].gust_ned.stack()))
    up, along = -found[0][:, 2], found[1][:, 0]
    # Points 7 and 8 are 200 and 100 m before the crest, 10 and 11 as far behind it.
    assert up[8] > 1.0
    assert up[8] == pytest.approx(-up[10], rel=1e-3)
    assert abs(up[9]) < 1e-3
    # Before the block the wind is as it was; 15 m behind it air comes back, far behind it is still slower.
    assert not along[:9].any()
    mean = 5.0 * np.log(100.0 / 0.04572) / np.log(6.096 / 0.04572)
    assert along[9] < -mean
    assert -mean < along[18] < -0.01


OWN = """
import jax.numpy as jnp
import qrsim

@qrsim.record
class Fountain:
    up: float = qrsim.parameter(2.0, unit="m/s", doc="everywhere", minimum=0.0)
    {extra}

    def velocity_ned(self, position_ned, height_agl, wind_ned, seconds, fraction{more}):
        zero = jnp.zeros_like(height_agl)
        return qrsim.Vec3(zero, zero, zero - self.up)
"""


def test_one_of_ones_own_is_taken_in_and_flown(tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_text(OWN.format(extra='reads = ("ground",)', more=", ground"))
    simulation = Simulation(qrsim.make_world(**held(updrafts=[{"type": f"{file}:Fountain", "up": 1.5}])), seed=1)
    simulation.reset()
    simulation.step(ticks=1)
    np.testing.assert_array_equal(simulation.truth.wind_ned[:, 2], -1.5)


def test_one_of_ones_own_that_reads_what_there_is_not_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "wrong.py"
    file.write_text(OWN.format(extra='reads = ("grund",)', more=", grund"))
    with pytest.raises(ScenarioError, match="which an updraft cannot read; did you mean 'ground'"):
        qrsim.make_scenario(**held(updrafts=[{"type": f"{file}:Fountain"}]))
