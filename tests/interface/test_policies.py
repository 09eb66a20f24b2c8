"""Users' policies and estimators in rollouts: all kinds do the same, and what is wrong with one is said."""

from __future__ import annotations

import functools
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.small_worlds import bare_pair, pair

from qrsim import Estimate, VelocitySetpoint, WaypointSetpoint
from qrsim.errors import RunError, UsageError
from qrsim.interface.policies import load_function, user_function
from qrsim.simulation.rollout import Rollout, rollout
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import World

SEED = 5
SAME = {"rtol": 2e-5, "atol": 2e-5}


def steer(reading: Any) -> Any:
    """Nods with the time and leans against the side drift: what is asked depends on time and on readings.

    The throttle is beyond its range in the second second; what the second vehicle is asked for is NaN from 3 s on.
    """
    time = reading.time
    drift = reading.gnss.position_ned[:, 1] - jnp.asarray([0.0, 9.0], jnp.float32)
    throttle = jnp.where((time >= 0.995) & (time < 1.995), 1.2, 0.59)
    asked = [0.1 * jnp.sin(time), throttle, jnp.where(time >= 2.995, jnp.nan, 0.2), 11.5]
    pitch, throttle, turn, battery = (jnp.broadcast_to(jnp.asarray(x, jnp.float32), (2,)) for x in asked)
    turn = jnp.where(jnp.arange(2) == 1, turn, 0.2)
    return jnp.stack([pitch, -0.05 * drift, throttle, turn, battery], axis=-1)


class Steer:
    """As steer, counting the times it was asked."""

    def init(self, reading: Any) -> Any:
        return {"asked": 0, "places": jnp.zeros((2, 3), jnp.float32)}

    def step(self, reading: Any, memory: Any) -> Any:
        # Beyond its 60th time it stops nodding.
        command = steer(reading)
        nod = jnp.where(memory["asked"] < 60, command[:, :1], 0.0)
        command = jnp.concatenate([nod, command[:, 1:]], axis=1)
        return command, {"asked": memory["asked"] + 1, "places": reading.gnss.position_ned}


def place(state: Any) -> Any:
    return jnp.stack(jax.tree.leaves(state.fleets[0].vehicle.position_ned), axis=-1)


@pytest.fixture(scope="module")
def world() -> World:
    return pair().world()


@pytest.fixture(scope="module")
def fly(world: World) -> Any:
    """A rollout of three worlds that records the places at every 10th tick."""
    return functools.partial(rollout, world, worlds=3, seed=SEED, ticks=140, record=place, record_every=10)


def simulated(world: World, ask: Any, ticks: int, number: int = 0) -> Any:
    """Places of a simulation that is given, at each tick, what ask(reading, tick) says; the last one."""
    simulation = Simulation(world, seed=SEED, number=number)
    reading = simulation.reset()
    for tick in range(ticks):
        reading = simulation.step(np.clip(ask(reading, tick), *CLIP))
    return simulation.truth.position_ned


CLIP = np.array([[-0.9, -0.9, 0.0, -4.5, 9.0], [0.9, 0.9, 1.0, 4.5, 12.0]], np.float32)


@pytest.fixture(scope="module")
def lock_step(fly: Any) -> Rollout:
    return fly(steer)


class TestKinds:
    def test_a_function_is_asked_at_every_tick(self, world, lock_step):
        expected = simulated(world, lambda reading, tick: steer(reading), 140, number=1)
        np.testing.assert_allclose(lock_step.recorded[1, -1], expected, **SAME)
        assert np.ptp(lock_step.recorded[:, -1, 0, 0]) > 1e-4

    def test_under_jit_it_flies_the_same(self, fly, lock_step):
        compiled = fly(jax.jit(steer))
        np.testing.assert_allclose(compiled.recorded, lock_step.recorded, **SAME)
        # What is beyond its range is clipped, and counted: the throttle from 1.00 s to 1.98 s.
        for flown in (compiled, lock_step):
            np.testing.assert_allclose(flown["clipped_s"], 1.0)

    @pytest.mark.long
    def test_an_object_remembers(self, world, fly):
        asked = []

        def ask(reading: Any, tick: int) -> Any:
            asked.append(np.array(steer(reading)))
            if tick >= 60:
                asked[-1][:, 0] = 0.0
            return asked[-1]

        flown = fly(Steer())
        np.testing.assert_allclose(flown.recorded[2, -1], simulated(world, ask, 140, number=2), **SAME)

    @pytest.mark.long
    def test_between_two_questions_the_command_is_held(self, world, fly):
        """Every seventh tick, in lock-step and in an object; the object's 20 times asked are fewer than 60."""
        held: list[Any] = []

        def ask(reading: Any, tick: int) -> Any:
            if tick % 7 == 0:
                held.append(np.array(steer(reading)))
            return held[-1]

        expected = simulated(world, ask, 140)
        assert len(held) == 20
        np.testing.assert_allclose(fly(steer, policy_ticks=7).recorded[0, -1], expected, **SAME)
        np.testing.assert_allclose(fly(Steer(), policy_ticks=7).recorded[0, -1], expected, **SAME)

    def test_set_points_and_guidance(self, world, fly):
        """None is the guidance of the fleet; a set-point of a policy leads elsewhere."""
        own = fly(ticks=100)
        np.testing.assert_allclose(fly(lambda reading: None, ticks=100).recorded, own.recorded, **SAME)
        south = fly(
            lambda reading: {"vehicles": VelocitySetpoint.of(np.array([[-1.0, 0, 0], [-1.0, 0, 0]]))}, ticks=100
        )
        assert np.all(own.recorded[:, -1, :, 0] > 0.5)
        assert np.all(south.recorded[:, -1, :, 0] < -0.5)

    def test_different_kinds_for_different_worlds_are_refused(self, fly):
        turns = iter([None, WaypointSetpoint.of(np.zeros((2, 3))), None])
        with pytest.raises(UsageError, match="it answers in different kinds to different worlds"):
            fly(lambda reading: next(turns))


def believe(reading: Any, shift: Any = 0.0) -> Estimate:
    """What the sensors say, the position shifted along east."""
    gnss, height, rate = reading.gnss, reading.barometer.height, reading.barometer.height_rate
    lib = jnp if isinstance(height, jax.Array) else np
    place = lib.stack([gnss.position_ned[:, 0], gnss.position_ned[:, 1] + shift, -height], axis=-1)
    velocity = lib.stack([gnss.velocity_ned[:, 0], gnss.velocity_ned[:, 1], -rate], axis=-1)
    return Estimate.of(place, velocity, reading.attitude.attitude)


class Shifting:
    """An estimator that shifts by what it remembers."""

    def __init__(self, shift: float):
        self.shift = shift

    def init(self, reading: Any) -> Any:
        return jnp.float32(0.0)

    def step(self, reading: Any, memory: Any) -> Any:
        return believe(reading, memory), jnp.float32(self.shift)


class TestEstimators:
    @pytest.mark.long
    def test_feeds_the_controllers(self, fly):
        """One that says what the sensors say changes nothing; one that is 2 m off to the east leads 2 m west."""
        plain = fly(ticks=100)
        np.testing.assert_allclose(fly(estimator=believe, ticks=100).recorded, plain.recorded, **SAME)
        shifted = fly(estimator=functools.partial(believe, shift=2.0), ticks=1000).recorded[:, -1]
        compiled = fly(estimator=Shifting(2.0), ticks=1000).recorded[:, -1]
        # The one with memory begins a tick later.
        np.testing.assert_allclose(compiled[:, 1], shifted[:, 1], atol=0.05)
        np.testing.assert_allclose(shifted[:, 1, 1], 7.0, atol=0.35)

    def test_what_it_does_not_know_is_believed_as_before(self, fly):
        """As with sensors: from a start at rest nothing is ever known but the start, and all lean ahead for good."""

        def nothing(reading: Any) -> Estimate:
            return Estimate.of(*(np.full((2, 3), np.nan),) * 3)

        flown = fly(estimator=nothing, ticks=100)
        assert np.all(flown.recorded[:, -1, :, 0] > 3.0)
        assert np.all(np.isfinite(flown.recorded))

    @pytest.mark.parametrize(
        ("answer", "message"),
        [
            (np.zeros((2, 9)), "estimator .*: estimate: expected a qrsim.Estimate"),
            (None, "estimator .*: estimate: expected a qrsim.Estimate, found None"),
            (Estimate.of(*(np.zeros((3, 3)),) * 3), r"expected shape \(2,\), found shape \(3,\)"),
        ],
    )
    @pytest.mark.parametrize("kind", [lambda function: function, jax.jit])
    def test_wrong_answers(self, fly, answer: Any, message: str, kind: Any):
        with pytest.raises(UsageError, match=message):
            fly(estimator=kind(lambda reading: answer))


class Broken:
    """An object with a wrong init or step."""

    def __init__(self, init: Any = lambda reading: 0, step: Any = lambda reading, memory: (None, memory)):
        self.init, self.step = init, step


def fails(reading: Any) -> Any:
    raise KeyError("no such key")


class TestWhatIsWrong:
    @pytest.mark.parametrize(
        ("policy", "message"),
        [
            (lambda: None, r"policy .*<lambda>: it is called with 1 argument \(reading\), but takes \(\)"),
            (jax.jit(lambda reading, gain: None), "it is called with 1 argument"),
            (Broken(init=lambda: 0), r"Broken.init: it is called with 1 argument \(reading\)"),
            (Broken(step=lambda reading: None), r"Broken.step: it is called with 2 arguments \(reading, memory\)"),
            (Steer, r"Steer: a class with init and step; give an object of it, Steer\(...\)"),
            (3, "expected a function of a reading, .* found 3"),
            ("hover", "expected a function of a reading"),
        ],
    )
    def test_signatures(self, fly, policy: Any, message: str):
        with pytest.raises(UsageError, match=message):
            fly(policy)

    @pytest.mark.parametrize("kind", [lambda function: function, jax.jit])
    @pytest.mark.parametrize(
        ("answer", "message"),
        [
            (np.zeros((2, 4)), r"expected shape \(2, 5\) .* found shape \(2, 4\)"),
            ([[0.0] * 5, [0.0] * 4], r"expected shape \(2, 5\)"),
            (VelocitySetpoint.of(np.zeros((1, 3))), r"velocity_ned.x: expected shape \(2,\), found shape \(1,\)"),
            ({"vehicle": None}, "no fleet and no vehicle is called 'vehicle'; did you mean 'vehicles'"),
            ("hover", "expected an array .* found 'hover'"),
        ],
    )
    def test_answers(self, fly, answer: Any, message: str, kind: Any):
        with pytest.raises(UsageError, match=f"policy .*{message}"):
            fly(kind(lambda reading: answer))

    def test_not_finite_in_lock_step(self, fly):
        with pytest.raises(
            UsageError, match=r"at tick 150 of world 0: .*yaw_rate of vehicle 1 \('vehicles_1'\) is nan"
        ):
            fly(steer, ticks=200)
        with pytest.raises(UsageError, match=r"velocity_ned.y of vehicle 1 \('vehicles_1'\) is not finite"):
            fly(lambda reading: VelocitySetpoint.of(np.array([[0.0, 0, 0], [0, np.inf, 0]])))

    def test_not_finite_in_a_compiled_policy(self, fly):
        message = r"steer: .*vehicle 1 \('vehicles_1'\) is not finite at tick 150 of world 0"
        with pytest.raises(UsageError, match=message):
            fly(jax.jit(steer), ticks=200)

    @pytest.mark.parametrize("kind", [lambda function: function, jax.jit])
    def test_a_vehicle_that_has_stopped_has_nothing_to_say(self, kind: Any):
        """Its readings are NaN, and so is what a policy makes of them; the other flies on."""
        beyond = [[0.0, 0.0, -10.0], [0.0, 9.0, -12.0]]
        vehicles = [{"position_ned": at, "waypoints_ned": [[1, 1, -10]] * 2} for at in beyond]
        vehicles[0]["velocity_body"] = [0.0, -9.0, 0.0]
        edge = {"type": "box", "x_min": -40.0, "x_max": 40.0, "y_min": -1.0, "y_max": 40.0, "z_min": -40.0}
        own = pair(vehicles=vehicles, area=edge).world()
        flown = rollout(own, kind(steer), worlds=3, seed=SEED, ticks=140, record=place, record_every=10)
        assert [bool(why) for why in flown.reasons(0)] == [True, False]
        np.testing.assert_allclose(flown["flown_s"][:, 1], 2.8)

    def test_an_exception_is_the_cause(self, fly):
        with pytest.raises(RunError, match="policy fails, at tick 0 of world 0: KeyError: 'no such key'") as lock_step:
            fly(fails)
        with pytest.raises(RunError, match="policy fails: KeyError") as compiled:
            fly(jax.jit(fails))
        with pytest.raises(RunError, match="policy Broken: KeyError") as at_the_start:
            fly(Broken(init=fails))
        for found in (lock_step, compiled, at_the_start):
            assert isinstance(found.value.__cause__, KeyError)
            assert re.search(r" \(\S*test_policies\.py, line \d+\)$", str(found.value))

    def test_readings_that_are_not_there(self, fly):
        with pytest.raises(RunError, match="no sensor is called 'gns'; did you mean 'gnss'"):
            fly(lambda reading: reading.gns.position_ned)
        with pytest.raises(UsageError, match="latitude_deg: not available in a compiled function"):
            fly(jax.jit(lambda reading: reading.gnss.latitude_deg))

    @pytest.mark.parametrize(
        "needs_values",
        [
            lambda reading: np.zeros((2, 5)) + np.sin(reading.gnss.position_ned[0, 0]),
            lambda reading: None if reading.time > 1.0 else np.zeros((2, 5)),
            lambda reading: np.full((2, 5), float(reading.gnss.position_ned[0, 0])),
            lambda reading: reading.gnss.position_ned[reading.gnss.position_ned > 0.0],
        ],
    )
    def test_numpy_in_a_compiled_policy(self, fly, needs_values: Any):
        with pytest.raises(UsageError, match=r"it cannot be compiled, .* write it with jax.numpy"):
            fly(jax.jit(needs_values))

    @pytest.mark.parametrize(
        ("policy", "message"),
        [
            (Broken(step=lambda reading, memory: None), "step must return a pair"),
            (Broken(step=lambda reading, memory: (None, memory, 1)), "step must return a pair"),
            (Broken(step=lambda reading, memory: (None, [memory])), "a memory like that of init"),
            (
                Broken(lambda reading: jnp.zeros(2), lambda reading, memory: (None, jnp.zeros(3))),
                r"expected an array of float32 \(2,\), found float32 \(3,\)",
            ),
            (
                Broken(lambda reading: jnp.int32(0), lambda reading, memory: (None, memory + jnp.float32(0.5))),
                "expected an array of int32",
            ),
        ],
    )
    def test_memories(self, fly, policy: Any, message: str):
        if "int32" in message:
            policy.step = lambda reading, memory: (None, memory.astype(jnp.float32))
        with pytest.raises(UsageError, match=f"policy Broken: .*{message}"):
            fly(policy)


class TestUserFunction:
    def test_none_is_none(self):
        assert user_function("policy", None) is None

    def test_which_are_compiled(self):
        for given, compiled in (
            (steer, False),
            (jax.jit(steer), True),
            (Steer(), True),
            (functools.partial(steer), False),
        ):
            found = user_function("policy", given)
            assert found is not None
            assert found.compiled is compiled

    def test_of_the_same_object_are_equal(self):
        """So that a second rollout compiles nothing."""
        one, two = Steer(), Steer()
        assert user_function("policy", one) == user_function("policy", one)
        assert user_function("policy", one) != user_function("policy", two)


class TestLoadFunction:
    @pytest.fixture(autouse=True)
    def folder(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        """A working folder with a module, which is forgotten afterwards."""
        (tmp_path / "pilot_of_mine.py").write_text(
            "from __future__ import annotations\nfrom dataclasses import dataclass\ncalls = []\n\n\n"
            "@dataclass\nclass Memory:\n    count: int = 0\n\n\ndef hover(reading):\n    return None\n"
        )
        (tmp_path / "breaks_here.py").write_text("1 / 0\n")
        (tmp_path / "needs_more.py").write_text("import not_installed_anywhere\n")
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "path", list(sys.path))
        before = set(sys.modules)
        yield tmp_path  # type: ignore[misc]
        for name in set(sys.modules) - before:
            del sys.modules[name]

    def test_of_a_module_and_of_a_file(self, folder):
        assert load_function("policy", "pilot_of_mine:hover")(None) is None
        assert load_function("policy", str(folder / "pilot_of_mine.py") + ":hover")(None) is None
        assert load_function("policy", "pilot_of_mine.py:Memory")().count == 0

    def test_a_file_is_one_module(self):
        one, two = (load_function(what, "pilot_of_mine.py:calls") for what in ("policy", "estimator"))
        assert one is two

    @pytest.mark.parametrize(
        ("source", "message"),
        [
            ("hover", "expected module:function or file.py:function"),
            (":hover", "expected module:function"),
            ("pilot_of_mine:", "expected module:function"),
            ("pilot_of_mime:hover", "no module is called 'pilot_of_mime'; did you mean 'pilot_of_mine'"),
            ("pilot_of_mine:hoover", "pilot_of_mine has no 'hoover'; did you mean 'hover'"),
            ("pilot_of_mine.py:hoover", "pilot_of_mine.py has no 'hoover'; did you mean 'hover'"),
            ("pilot_of_mime.py:hover", "there is no file pilot_of_mime.py; did you mean 'pilot_of_mine.py'"),
            ("away/pilot.py:hover", "there is no file away/pilot.py$"),
            ("breaks_here:hover", "breaks_here: importing it failed: ZeroDivisionError: division by zero"),
            ("breaks_here.py:hover", "breaks_here.py: importing it failed: ZeroDivisionError"),
            ("needs_more:hover", "needs_more: it imports 'not_installed_anywhere', which is not there"),
            ("qrsim.sweep.metrics:of", "no module is called 'qrsim.sweep.metrics'; .* 'qrsim.studies.sweep.metrics'"),
            ("needs_more.py:hover", "needs_more.py: importing it failed: ModuleNotFoundError"),
        ],
    )
    def test_what_cannot_be_loaded(self, source: str, message: str):
        with pytest.raises(UsageError, match=f"policy.*{message}"):
            load_function("policy", source)


def test_a_word_that_is_nearly_right_is_named() -> None:
    with pytest.raises(UsageError, match="for example my_policy:hover; did you mean 'baseline'\\?"):
        load_function("policy", "basline", ("baseline",))
    with pytest.raises(UsageError, match=r"for example my_policy:hover, or 'baseline'$"):
        load_function("policy", "pilot", ("baseline",))


@dataclass
class Throttle:
    """A policy, and what sums up a flight: both with an attribute, and neither with a hash."""

    amount: float

    def init(self, reading: Any, state: Any = None) -> Any:
        return jnp.zeros(2)

    def step(self, reading: Any, memory: Any) -> Any:
        return jnp.asarray([[0.0, 0.0, self.amount, 0.0, 12.0]] * 2), memory

    def update(self, total: Any, world: Any, state: Any, tick: Any) -> Any:
        return total + self.amount

    def finish(self, total: Any, world: Any, state: Any) -> Any:
        return {"total": total}


def test_an_attribute_that_has_changed_is_flown():
    """It flew, and summed up, as the object was when it was compiled first."""
    world, policy, metrics = bare_pair().world(), Throttle(0.4), Throttle(1.0)

    def fly() -> Any:
        flown = rollout(world, policy, ticks=5, metrics=metrics, record=place, record_every=5)
        # Down is positive.
        return flown["total"][0, 0], flown.recorded[0, 1, 0, 2] - flown.recorded[0, 0, 0, 2]

    first = fly()
    policy.amount, metrics.amount = 0.9, 3.0
    second = fly()
    assert (first[0], second[0]) == (5.0, 15.0)
    assert second[1] < first[1]
