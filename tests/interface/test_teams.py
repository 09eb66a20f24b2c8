"""A policy for each team: what it sees, what it commands, and what is said of wrong ones."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.errors import UsageError
from qrsim.interface.policies import load_function, sources_by_team, user_function

# Flown on the truth, which is quick to compile.
ON_TRUTH: dict[str, Any] = {"controller": {"type": "offboard", "feed": "truth"}, "sensors": {"gnss": "ideal_gnss"}}
FLEETS: dict[str, Any] = {
    "scouts": {"vehicles": [[0.0, 0.0, -20.0], [0.0, 20.0, -20.0]], **ON_TRUTH},
    "cats": {"vehicles": [[40.0, 0.0, -10.0]], **ON_TRUTH},
}


@pytest.fixture(scope="module")
def world() -> Any:
    return qrsim.make_world(fleets=FLEETS)


def tilt(reading: Any) -> Any:
    """Lean by how far north one is."""
    north = reading.gnss.position_ned[:, 0]
    zero = 0.0 * north
    return jnp.stack([zero, 0.1 + 0.01 * north, zero + 0.59, zero, zero + 12.0], axis=-1)


def away(reading: Any) -> Any:
    return qrsim.WaypointSetpoint.of(reading.gnss.position_ned + jnp.asarray([[0.0, 5.0, 0.0]]), 0.0)


class Counts:
    """Climbs for its first ten times, and then leans: a policy with a memory of its own, in NumPy."""

    made = 0

    def __init__(self) -> None:
        self.asked = 0
        type(self).made += 1

    def __call__(self, reading: Any) -> Any:
        self.asked += 1
        throttle = 0.7 if self.asked <= 10 else 0.5
        return np.tile([0.0, 0.05, throttle, 0.0, 12.0], (len(reading.gnss.position_ned), 1))


class Remembers:
    """The same with a memory that is handed on: a list."""

    compiled = False

    def init(self, reading: Any) -> list[float]:
        return []

    def step(self, reading: Any, memory: list[float]) -> Any:
        memory.append(reading.time)
        throttle = 0.7 if len(memory) <= 10 else 0.5
        return np.tile([0.0, 0.05, throttle, 0.0, 12.0], (len(reading.gnss.position_ned), 1)), memory


class Drifts:
    """Leans a little more each time: a memory that is compiled."""

    def init(self, reading: Any) -> Any:
        return jnp.zeros(())

    def step(self, reading: Any, lean: Any) -> Any:
        zero = jnp.zeros_like(reading.gnss.position_ned[:, 0])
        return jnp.stack([zero, zero + lean, zero + 0.59, zero, zero + 12.0], axis=-1), lean + 0.005


@pytest.mark.long
def test_each_sees_and_commands_its_own(world: Any) -> None:
    seen: dict[str, Any] = {}

    def scouts(reading: Any) -> Any:
        seen["scouts"] = (reading.fleets, np.shape(reading.gnss.position_ned), reading.names)
        return tilt(reading)

    def cat(reading: Any) -> Any:
        seen["cat"] = (reading.names, np.shape(reading.gnss.position_ned), np.shape(reading.gnss.fresh))
        assert reading.gnss.reasons == [""]
        return away(reading)

    flown = qrsim.play(world, {"scouts": scouts, "cats_0": cat}, ticks=40)
    assert seen["scouts"] == (("scouts",), (2, 3), ("scouts", "scouts_0", "scouts_1"))
    assert seen["cat"] == (("cats_0",), (1, 3), (1,))
    sim = qrsim.Simulation(world)
    reading = sim.reset()
    for _ in range(40):
        reading = sim.step({"scouts": tilt(reading["scouts"]), "cats": away(reading["cats"])})
    np.testing.assert_allclose(flown.position_ned[-1], sim.truth.position_ned, atol=2e-5)
    assert flown.vehicles == ("scouts_0", "scouts_1", "cats_0")


@pytest.mark.long
def test_kinds_mix_and_agree_in_rollouts(world: Any) -> None:
    plain = {"scouts": tilt, "cats": away}
    flights = [
        qrsim.rollout(world, each, ticks=40, worlds=2)["position_ned"]
        for each in (plain, {name: jax.jit(policy) for name, policy in plain.items()}, {**plain, "cats": jax.jit(away)})
    ]
    for flight in flights[1:]:
        np.testing.assert_allclose(flight, flights[0], atol=2e-5)
    played = qrsim.play(world, plain, ticks=40, record_every=15)
    np.testing.assert_array_equal(played.ticks, [0, 15, 30, 40])
    np.testing.assert_allclose(played.time, [0.0, 0.3, 0.6, 0.8])
    np.testing.assert_allclose(played.position_ned[-1], flights[0][0], atol=2e-5)


@pytest.mark.long
def test_who_is_in_no_team_flies_by_its_guidance(world: Any) -> None:
    alone = qrsim.play(world, {"cats": Drifts()}, ticks=40)
    guided = qrsim.rollout(world, ticks=40)["position_ned"][0]
    np.testing.assert_allclose(alone.position_ned[-1, :2], guided[:2], atol=2e-5)
    assert np.abs(alone.position_ned[-1, 2] - guided[2]).max() > 0.02
    many = qrsim.rollout(world, {"cats": Drifts()}, ticks=40)["position_ned"][0]
    np.testing.assert_allclose(many, alone.position_ned[-1], atol=2e-5)


@pytest.mark.long
def test_each_world_has_a_memory_of_its_own(world: Any) -> None:
    """Two worlds of one seed and number fly alike, however the memory is kept; one shared memory would end the climb of
    both after five ticks each.
    """
    before = Counts.made
    by_class = qrsim.rollout(world, {"scouts": Counts}, ticks=30, seeds=[4, 4])["position_ned"]
    assert Counts.made == before + 2
    by_memory = qrsim.rollout(world, {"scouts": Remembers()}, ticks=30, seeds=[4, 4])["position_ned"]
    played = qrsim.play(world, {"scouts": Remembers()}, ticks=30, seed=4).position_ned[-1]
    for flight in (by_class[1], by_memory[0], by_memory[1], played):
        np.testing.assert_allclose(flight, by_class[0], atol=1e-6)
    # 0.2 s at 0.7 and 0.4 s at 0.5 of the throttle; 0.1 s and 0.5 s would end 0.1 m lower.
    shared = qrsim.play(world, {"scouts": lambda reading: Counts()(reading)}, ticks=30, seed=4)
    assert shared.position_ned[-1, 0, 2] < by_class[0, 0, 2] - 0.05


def test_a_vehicle_that_two_command_is_refused(world: Any) -> None:
    def meddles(reading: Any) -> Any:
        return {"cats": np.array([[0.0, 0.0, 0.59, 0.0, 12.0]])}

    with pytest.raises(UsageError, match=r"of 'scouts': it commands 'cats', which is not its own"):
        qrsim.play(world, {"scouts": meddles, "cats": tilt}, ticks=2)
    with pytest.raises(UsageError, match=r"'scouts_1' is of fleet 'scouts', which is given a command too"):
        qrsim.play(world, {"scouts": tilt, "scouts_1": tilt}, ticks=2)


@pytest.mark.parametrize(
    ("policies", "said"),
    [
        ({"scout": tilt}, "no fleet and no vehicle is called 'scout'; did you mean 'scouts'"),
        ({}, "the dict names no policy"),
        ({"scouts": None}, "the dict names no policy"),
        ({"scouts": 3.0}, "expected a function of a reading, an object with init and step, a class, or a dict"),
        (tilt, "policies: expected a dict with one for each team"),
        ({"scouts": Drifts}, "Drifts: a class with init and step; give an object of it"),
        ({"scouts": int}, "int: objects of this class cannot be called"),
        ({"scouts": lambda reading: [[0.0, 0.1]]}, r"expected shape \(2, 5\)"),
        ({"cats": lambda reading: reading["scouts"]}, "the readings of 'scouts' are not among those of 'cats'"),
    ],
)
def test_what_is_wrong_is_said(world: Any, policies: Any, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        qrsim.play(world, policies, ticks=2)


def test_an_estimator_is_for_all() -> None:
    with pytest.raises(UsageError, match="estimator: a dict by fleet is for policies alone"):
        user_function("estimator", {"scouts": tilt})


def test_names_on_the_command_line(tmp_path: Any) -> None:
    file = tmp_path / "ours.py"
    file.write_text("def one(reading):\n    return None\n\n\ndef two(reading):\n    return None\n")
    found: Any = load_function("policy", f"scouts={file}:one, cats={file}:two")
    assert {name: function.__name__ for name, function in found.items()} == {"scouts": "one", "cats": "two"}
    assert sources_by_team(f"{file}:one") is None
    assert sources_by_team("C:/a=b.py:one") is None
    with pytest.raises(UsageError, match="has no 'tow'; did you mean 'two'"):
        load_function("policy", f"scouts={file}:tow")
