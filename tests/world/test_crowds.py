"""Who looks for others finds all whom all pairs give, or says that it may not have (collisions: llvm/test_ticks.py)."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.control.teams import mates_of
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import NeighbourWarning
from qrsim.interface.crowds import crowds_of
from qrsim.models.radio.contracts import STREAMS, Exchange, Outbox, Surfaces
from qrsim.models.radio.network import Network
from qrsim.models.radio.parameters import Delay, InboxSize, Packet, PathLoss
from qrsim.models.scene.ground import FlatGround
from qrsim.models.scene.traffic import Traffic
from qrsim.models.sensors.neighbours import IdealNeighbours

Array = np.ndarray[Any, Any]
COUNT, REACH, KNOWN = 240, 30.0, 5
TRUTH: Any = {"type": "velocity_height", "feed": "truth"}


def by_hand(points: Array) -> Array:
    """Return the numbers (KNOWN, n) of the nearest within reach, by all pairs; -1 for nobody."""
    squared = ((points[:, :, None] - points[:, None, :]) ** 2).sum(axis=0)
    squared[np.eye(points.shape[1], dtype=bool) | (squared > REACH**2)] = np.inf
    index = np.argsort(squared, axis=0, kind="stable")[:KNOWN]
    return np.where(np.isfinite(np.take_along_axis(squared, index, axis=0)), index, -1)


@jax.jit
def found(points: Any) -> dict[str, Any]:
    """Return whom sensors, teams and radios find, (KNOWN, n), and who of each says that it may have missed some."""
    place = Vec3(*points)
    zero = jnp.zeros_like(place.x)
    traffic = Traffic(place, Vec3(zero, zero, zero), zero == 0.0, zero, ("a",), (COUNT,))
    sensor, level = IdealNeighbours(slots=KNOWN, range_max=REACH), Euler(zero, zero, zero)  # type: ignore[arg-type]
    state, seen = sensor.init(
        None, position_ned=place, attitude=level, obstacles=None, ground=FlatGround(), traffic=traffic
    )
    mates = mates_of(place, place, jnp.float32(REACH), KNOWN)
    inbox = InboxSize(size=KNOWN, candidates=KNOWN, reach=REACH)  # type: ignore[arg-type]
    packet = Packet(model="probability", probability=1.0, range=1000.0)  # type: ignore[arg-type]
    radio = cast(
        Network(path_loss=PathLoss(shadowing_db=0.0, waves=2), delay=Delay(), packet=packet, inbox=inbox),
        np.dtype(np.float32),
    )
    waves = Key.root(1).stream("field", jnp.arange(radio.field_ids, dtype=jnp.uint32))
    ids, tick = np.arange(COUNT, dtype=np.uint32), jnp.int32(0)
    start = radio.init(Draw(waves, tick, jnp.float32(0)), Key.root(1).streams(STREAMS), place.x)
    said = Outbox(jnp.zeros((radio.size, COUNT)), zero == 0.0, jnp.full(COUNT, -1, jnp.int32))
    after = radio.exchange(start, Exchange(None, said, Surfaces(place, zero == 0.0), ids, tick, tick, 0.02))
    return {
        "sensor": (jnp.nan_to_num(jnp.stack(seen.vehicle), nan=-1.0), state),
        "team": (mates.number, mates.overfull),
        "radio": (radio.links(after).sender, after.counts.overfull),
    }


@pytest.mark.long
def test_sensors_teams_and_radios_find_those_of_all_pairs() -> None:
    """Whoever does not say that it may have missed some; the more the vehicles are spread, the fewer say so."""
    random = np.random.default_rng(20261122)
    for size, share in ((80.0, 0.0), (300.0, 0.6), (500.0, 1.0), (700.0, 1.0)):
        points = random.uniform(0.0, size, (3, COUNT)).astype(np.float32)
        points[2] /= 10.0
        points[0, 7] = np.nan
        expected = by_hand(points.astype(np.float64))
        assert (expected >= 0).any(axis=0).mean() > 0.1
        for who, (number, missed) in found(points).items():
            sure = ~np.asarray(missed, bool)
            assert sure.mean() >= share, who
            np.testing.assert_array_equal(np.asarray(number)[:, sure], expected[:, sure], err_msg=who)


def test_in_a_crowd_all_say_that_they_may_have_missed_some() -> None:
    """All within 20 m: each has 239 near, more than are told apart of one column, 64."""
    points = np.random.default_rng(3).uniform(0.0, 20.0, (3, COUNT)).astype(np.float32)
    for who, (_, missed) in found(points).items():
        assert np.asarray(missed, bool).all(), who


def crowd(count: int = 110, **parts: Any) -> Any:
    """Return a scenario of vehicles 2.5 m apart, of which there are too many around each from 98 on."""
    places = [(2.5 * (i % 20), 2.5 * (i // 20) + 0.1, -20.0) for i in range(count)]
    given: Any = {"collision_distance": 0.1, "duration": 0.2, "name": "crowd", "sensors": {}, "controller": TRUTH}
    return qrsim.make_scenario(places, **given | parts)


def test_a_run_says_what_a_team_may_have_missed(tmp_path: Any) -> None:
    """Once with the first vehicle and once with the number of looks: of 110 vehicles in ten ticks."""
    said = (
        "fleets.vehicles.guidance: 1100 times a vehicle had more others around it than were looked at, so that it may"
    )
    with pytest.warns(NeighbourWarning, match=said):
        qrsim.fly(crowd(guidance={"type": "flocking"}), tmp_path / "run", seed=1, precision="float32")
    run = qrsim.open_run(tmp_path / "run")
    first, last = (event for event in run.events if event.kind == "neighbours_overfull")
    assert (first.vehicle, first.tick, first.field) == ("vehicles_0", 1, "fleets.vehicles.guidance")
    named = "vehicles_0: fleets.vehicles.guidance had more others around it than are looked at, first at 0.02 s"
    assert first.message == named
    assert (last.vehicle, last.tick, last.value) == (None, 10, 1100.0)
    assert said in last.message


def test_where_there_is_room_nothing_is_counted() -> None:
    """97 vehicles always find room; so do 193 a sensor."""
    few = crowd(97, guidance={"type": "flocking"}).world()
    assert few.fleets[0].guidance.init(few.fleets[0].route).overfull is None
    state = SimpleNamespace(fleets=[SimpleNamespace(guidance=None, sensors=())])
    assert crowds_of(crowd(3).world(), state) == []  # type: ignore[arg-type]


@pytest.mark.long
def test_rollouts_and_simulations_say_what_sensors_may_have_missed() -> None:
    """A reading at the start, and no other in 0.1 s; set anew, what was counted stays, and counts once more."""
    eyes = {"eyes": {"type": "ideal_neighbours", "range_max": 60.0, "velocity": True, "period": 0.2}}
    world = crowd(240, sensors=eyes).world()
    with pytest.warns(NeighbourWarning, match=r"fleets.vehicles.sensors.eyes: \d+ times .*eyes.range_max"):
        flown = qrsim.rollout(world, ticks=5)
    assert (flown["neighbours_overfull"] == 1).all()
    simulation = qrsim.Simulation(world)
    simulation.reset()
    with pytest.warns(NeighbourWarning):
        simulation.step()
    (before,) = (one.looks for one in crowds_of(simulation.world, simulation.state))
    simulation.set_state(simulation.truth.position_ned)
    (after,) = (one.looks for one in crowds_of(simulation.world, simulation.state))
    np.testing.assert_array_equal(after, 2 * before)
