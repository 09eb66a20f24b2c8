"""What there was beside the vehicles of a recorded run, against the simulation that was recorded."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.runs import open_run
from qrsim.runs.recorder import fly
from qrsim.scenarios.injection_file import read_injections
from qrsim.scenarios.live_requests import wind
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.simulation.simulation import Simulation
from qrsim.view.clock import Clock
from qrsim.view.frame import frame_of
from qrsim.view.live import LiveView
from qrsim.view.recording import Recording
from qrsim.world.episode import develop, picture

pytestmark = pytest.mark.long

SEED = 3


@cache
def searched() -> Scenario:
    """Return a search whose persons are found from afar."""
    persons = ("found_distance=200", "found_speed=50", "period=2.0")
    return load_scenario("search_and_rescue/2D", ["duration=4", *(f"world.persons.{each}" for each in persons)])


@cache
def puffing(*more: str) -> Scenario:
    """Return a mapping of puffs that come every second."""
    return load_scenario("plume_mapping/3E", ["duration=6", "world.plume.gap=1.0", "world.plume.puffs=600", *more])


def recorded(scenario: Scenario, folder: Path) -> Recording:
    """Fly a scenario and read what was recorded."""
    fly(scenario, folder, seed=SEED, precision="float32")
    return Recording(open_run(folder))


def simulated(scenario: Scenario, time: float) -> Simulation:
    """Return the simulation at a time [s]."""
    simulation = Simulation(scenario.world(), seed=SEED)
    simulation.reset()
    if time:
        simulation.advance(ticks=round(time / simulation.world.time_step))
    return simulation


def same(found: Any, wanted: Any) -> None:
    """Compare two trees up to the rounding of differently compiled programs."""
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-4)


@pytest.fixture(scope="module")
def search(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return recorded(searched(), tmp_path_factory.mktemp("search") / "run")


def test_ground_and_persons_are_there_and_found_when_they_were(search: Recording):
    found = []
    for time in (1.9, 2.0, 3.0, 0.5):
        beside = search.frame(time).beside
        assert beside is not None
        same(beside.contents, simulated(searched(), time).state.contents)
        found.append(int((np.asarray(beside.contents.persons.found_tick) >= 0).sum()))
    assert found[0] == found[3] == 0
    assert 0 < found[1] == found[2], "nobody was found: the test shows nothing"
    events = [event for event in search.run.events if event.kind == "person_found"]
    assert [(event.tick, event.field) for event in events] == [(100, "persons")] * found[1]
    assert all(event.vehicle in search.run.vehicles for event in events)


@pytest.mark.parametrize("time", [0.0, 2.5])
def test_pictures_are_those_that_were_taken(search: Recording, time: float):
    beside, simulation = search.frame(time).beside, simulated(searched(), time)
    assert beside is not None
    wanted = jax.jit(lambda world, state: picture(world, state, 0, "camera"))(simulation.world, simulation.state)
    (number, index), reading = next(iter(beside.cameras.items()))
    fleet = simulation.world.fleets[number]
    stream = beside.fleet_keys[number].stream(
        fleet.stream_names.index(fleet.sensor_names[index]), np.arange(fleet.size, dtype=np.uint32)
    )
    found = jax.jit(lambda world: develop(world, beside.contents, fleet.sensors[index], reading, stream))(beside.world)
    np.testing.assert_array_equal(found.rows, wanted.rows)
    np.testing.assert_allclose(found.ratio, wanted.ratio, atol=1e-2)
    assert np.nanstd(wanted.ratio) > 1.0


@pytest.mark.nightly
def test_puffs_are_where_they_were_at_any_time(tmp_path: Path):
    recording = recorded(puffing(), tmp_path / "run")
    for time in (2.0, 6.0, 4.5):
        beside = recording.frame(time).beside
        assert beside is not None
        same(beside.contents, simulated(puffing(), time).state.contents)
    assert np.asarray(beside.contents.plume.released).sum() > 0


def test_a_plume_goes_with_the_wind_that_was_asked_for(tmp_path: Path):
    view = LiveView(0, Clock(float("inf")))
    try:
        view.ask(wind(7.0, 90.0))
        # A wind that every episode draws cannot be changed.
        fly(puffing("ranges=[]"), tmp_path / "run", seed=SEED, precision="float32", view=view)
    finally:
        view.close()
    recording = Recording(open_run(tmp_path / "run"))
    winds = [recording.frame(time).beside.world.wind for time in (0.0, 6.0)]  # type: ignore[union-attr]
    assert [float(wind.speed_20ft) for wind in winds] == [1.0, 7.0]
    assert float(winds[1].wind_from_rad) == pytest.approx(np.pi / 2)


def test_a_wind_changes_as_slowly_as_in_flight(tmp_path: Path):
    events = "world.events=[{at: 1, wind: {speed_20ft: 3, over: 2}}]"
    scenario, (request,) = read_injections(puffing("ranges=[]", events), injections(tmp_path))
    fly(scenario, tmp_path / "run", seed=SEED, precision="float32", injections=[request])
    recording = Recording(open_run(tmp_path / "run"))
    winds = [recording.frame(time).beside.world.wind for time in (0.9, 2.0, 3.5, 4.5, 6.0)]  # type: ignore[union-attr]
    # From 1 to 3 m/s within 2 s, then to 7 m/s within 1 s.
    assert [float(wind.speed_20ft) for wind in winds] == pytest.approx([1.0, 2.0, 3.0, 5.0, 7.0])
    live = simulated(scenario, 2.0)
    frame = frame_of(live.state, live.time, live.world)
    assert float(frame.beside.world.wind.speed_20ft) == pytest.approx(2.0)  # type: ignore[union-attr]


def injections(folder: Path) -> Path:
    """Write a file with a change of the wind."""
    path = folder / "injections.yaml"
    path.write_text("[{target: world, kind: wind, at: 4, speed_20ft: 7, over: 1}]")
    return path


def test_where_nothing_is_beside_the_vehicles_nothing_is_rebuilt(tmp_path: Path):
    recording = recorded(load_scenario("patrol_plain", ["duration=0.1"]), tmp_path / "run")
    assert recording.frame(0.0).beside is None
