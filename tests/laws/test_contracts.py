"""What is asked of components is asked by contract: nothing is looked for by name, nothing else is relied on."""

from __future__ import annotations

import ast
import inspect
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.control.contracts import Controller, Estimator, Guidance
from qrsim.core.noise import Key
from qrsim.core.tree import quantity, record, replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.atmosphere.contracts import Gust, Turbulence, Updraft, Wind
from qrsim.models.gnss.contracts import RangeErrors
from qrsim.models.radio.contracts import Radio
from qrsim.models.scene.contracts import Area, Ground, GroundCover, People, Plume
from qrsim.models.sensors.barometer import IdealBarometer
from qrsim.models.sensors.contracts import Sensor
from qrsim.models.vehicles.contracts import Battery, Pose, Vehicle
from qrsim.scenarios import catalogue
from qrsim.tasks.contracts import Task
from qrsim.world import tick as ticks
from qrsim.world.air import around_of, gust_at, gust_rates_at
from qrsim.world.episode import draw_field, episode_draws
from qrsim.world.state import World

SOURCE = Path(qrsim.__file__).parent
CONTRACTS = {
    "WINDS": Wind, "TURBULENCES": Turbulence, "GUSTS": Gust, "UPDRAFTS": Updraft, "SKY_ERRORS": RangeErrors,
    "AREAS": Area, "GROUNDS": Ground,
    "PLUMES": Plume, "TERRAINS": GroundCover, "PERSONS": People, "TASKS": Task, "VEHICLES": Vehicle,
    "BATTERIES": Battery, "CONTROLLERS": Controller, "FILTERS": Estimator, "GUIDANCE": Guidance, "SENSORS": Sensor,
}  # fmt: skip
# A file that is read before the run; what it returns flies.
READ_BEFORE = {"series", "dem", "grid", "profile"}
# Check what a user handed in before it flies, which is to look for what is missing.
CHECKERS = {f"scenarios/{name}.py" for name in ("class_attributes", "conformity", "returns", "trial", "value_checks")}
# What is asked of classes as they are made, of modules, the operating system, errors, JAX's own objects and what a user
# handed in; never of a component. File -> how often.
ALLOWED = {
    "core/presets.py": 1, "core/sameness.py": 1, "core/structure.py": 1, "engine/cache.py": 3, "engine/folders.py": 1,
    "engine/llvm/background.py": 1, "engine/llvm/team.py": 1, "engine/llvm/operations.py": 1,
    "engine/llvm/rules.py": 1, "engine/llvm/tracing.py": 2,
    "engine/programs.py": 1, "engine/settings.py": 1, "envs/functional.py": 1, "files/code.py": 2,
    "files/interruptions.py": 3, "files/recordings.py": 1, "files/user_files.py": 3,
    "files/yaml_text.py": 1, "interface/policies.py": 6, "links/reference/connection.py": 2,
    "runs/parts.py": 1, "runs/reader.py": 1, "runs/writer.py": 1,
    "scenarios/components.py": 1, "scenarios/cross_checks.py": 1, "scenarios/interference.py": 1,
    "scenarios/making.py": 2, "scenarios/registry.py": 2, "scenarios/problems.py": 1, "scenarios/ranges.py": 1,
    "simulation/rollout.py": 1, "simulation/snapshot.py": 2, "studies/sweep/own_metrics.py": 1,
    "view/browser.py": 1, "view/gate.py": 1, "view/script.py": 1,
}  # fmt: skip


def test_nothing_is_looked_for_by_name() -> None:
    """``hasattr`` and ``getattr`` with a default stand for a contract that nobody wrote down."""
    found: Counter[str] = Counter()
    for path in SOURCE.rglob("*.py"):
        text = path.read_text()
        # To parse all files takes seconds.
        for node in ast.walk(ast.parse(text)) if "hasattr(" in text or "getattr(" in text else ():
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                asks = node.func.id == "hasattr" or (node.func.id == "getattr" and len(node.args) == 3)
                found[path.relative_to(SOURCE).as_posix()] += asks
    over = {name: count for name, count in found.items() if count > ALLOWED.get(name, 0) and name not in CHECKERS}
    assert over == {}, "give the component a method, a class variable or a type (contracts.py of its room)"


@pytest.mark.parametrize("group", CONTRACTS)
def test_every_component_has_its_contract(group: str) -> None:
    for name, cls in getattr(catalogue, group).items():
        if name not in READ_BEFORE and ":" not in name:
            assert CONTRACTS[group] in inspect.getmro(cls), name
            assert not inspect.isabstract(cls), name


@pytest.mark.parametrize("contract", [*CONTRACTS.values(), Estimator, Radio], ids=lambda contract: contract.__name__)
def test_a_contract_says_what_each_of_its_methods_is_for(contract: type) -> None:
    methods = [member for name, member in vars(contract).items() if not name.startswith("_") and callable(member)]
    assert methods
    for method in methods:
        assert method.__doc__, method
        inspect.signature(method)


@record
class Wrapped(Vehicle):
    """A vehicle that has nothing but the contract: no field of the one inside can be seen."""

    inside: Any = quantity()
    command_type: ClassVar[type[Any]] = qrsim.Command
    actions: ClassVar[tuple[type[Any], ...]] = (qrsim.Command,)
    normals: ClassVar[int] = 6
    adds_position: ClassVar[bool] = True

    def initial_state(self, *start: Any) -> Any:
        return self.inside.initial_state(*start)

    def with_thrust(self, state: Any, thrust: Any) -> Any:
        return self.inside.with_thrust(state, thrust)

    def idle_command(self, like: Any) -> Any:
        return self.inside.idle_command(like)

    def clip(self, command: Any, powered: bool = False) -> Any:
        return self.inside.clip(command, powered)

    def powered(self, command: Any, voltage: Any) -> Any:
        return self.inside.powered(command, voltage)

    def load(self, state: Any) -> Any:
        return self.inside.load(state)

    def wake(self) -> Any:
        return self.inside.wake()

    def wake_points(self) -> Any:
        return self.inside.wake_points()

    def pose(self, state: Any) -> Any:
        return self.inside.pose(state)

    def draw_noise(self, draw: Any, dt: float) -> Any:
        return self.inside.draw_noise(draw, dt)

    def step(self, state: Any, command: Any, air_velocity: Any, noise: Any, dt: float) -> Any:  # type: ignore[override]
        return self.inside.step(state, command, air_velocity, noise, dt)

    def specific_force(self, *arguments: Any) -> Any:
        return self.inside.specific_force(*arguments)

    def stopped(self, state: Any) -> Any:
        return self.inside.stopped(state)

    def with_wrapped_yaw(self, state: Any) -> Any:
        return self.inside.with_wrapped_yaw(state)


def lowered(world: World) -> str:
    """Return the StableHLO of a tick."""
    state = jax.eval_shape(ticks.reset, world, ticks.keys_of(world, Key.root(jnp.array([1, 0], jnp.uint32))))
    actions = (None,) * len(world.fleets)
    text: str = jax.jit(lambda *at: ticks.step(*at, actions)).lower(world, state, jnp.int32(3)).as_text()
    return text


def test_a_tick_asks_a_vehicle_for_nothing_but_its_contract() -> None:
    """The program of a tick is the same for the identified quadrotor and for one that hides all but the contract."""
    world = qrsim.load_scenario("patrol_plain").world()
    hidden = replace(world, fleets=tuple(replace(f, vehicle=Wrapped(f.vehicle)) for f in world.fleets))
    assert lowered(hidden) == lowered(world)


@record
class Lander(Wrapped):
    """Looks at the ground and at the rotation of the air."""

    reads: ClassVar[tuple[str, ...]] = ("ground", "air_rates")

    def step(  # type: ignore[override]
        self, state: Any, command: Any, air_velocity: Callable[..., Vec3], noise: Any, dt: float, around: Any
    ) -> Any:
        down, normal = around.ground(state.position_ned)
        after, force = self.inside.step(state, command, air_velocity, noise, dt)
        return after, Vec3(down, normal.z, around.air_rates.x + 0.0 * force.x)

    def specific_force(self, *arguments: Any) -> Any:
        return self.step(*arguments)[1]


def test_a_vehicle_that_reads_is_handed_what_is_around_it() -> None:
    world = qrsim.load_scenario("patrol_plain").world()
    hidden = replace(world, fleets=tuple(replace(fleet, vehicle=Lander(fleet.vehicle)) for fleet in world.fleets))
    state = jax.eval_shape(ticks.reset, hidden, Key.root(jnp.array([1, 0], jnp.uint32)))
    # The lander fails in ``step`` and ``specific_force`` where it is handed nothing.
    after = jax.eval_shape(lambda *at: ticks.step(*at, (None,) * len(world.fleets)), hidden, state, jnp.int32(3))
    assert after.fleets[0].specific_force.y.shape == (world.fleets[0].size,)
    east = Euler(jnp.zeros(2), jnp.zeros(2), jnp.full(2, jnp.pi / 2))
    still = Vec3(*jnp.zeros((3, 2)))
    place = replace(still, z=jnp.array([0.0, -1000.0]))
    around = around_of(world, Pose(place, east, still, still), Vec3(*jnp.ones((3, 2))))
    down, normal = around.ground(Vec3(*jnp.full((3, 2), -7.0)))
    np.testing.assert_array_equal(down, [0.0, 0.0])
    np.testing.assert_array_equal(normal.stack(), [[0.0, 0.0, -1.0]] * 2)
    # Heading east: forward is east, right is south.
    np.testing.assert_allclose(around.air_rates.stack(), [[1.0, -1.0, 1.0]] * 2, atol=1e-6)
    # ISO 2533 has 1.11164 kg/m^3 at 1000 m.
    np.testing.assert_allclose(around.air_density, [1.225, 1.11164], rtol=1e-5)
    turned = around_of(world, Pose(place, Euler(*jnp.zeros((3, 2))), still, still), None, Vec3(*jnp.full((3, 2), 0.5)))
    np.testing.assert_array_equal(turned.air_rates.stack(), np.full((2, 3), 0.5))


@record
class Slow(IdealBarometer):
    """A barometer whose readings are two periods old."""

    delay: ClassVar[int] = 2  # type: ignore[misc]


def test_a_sensor_says_when_its_reading_is_new_and_when_it_was_true() -> None:
    sensor = Slow(period=0.1)
    assert [tick for tick in range(1, 16) if sensor.fresh(tick, 0.02)] == [5, 10, 15]  # type: ignore[arg-type]
    found = [int(sensor.time_of_reading(tick, 0.02)) for tick in (4, 14, 15, 19, 20)]  # type: ignore[arg-type]
    assert found == [0, 0, 5, 5, 10]


@record
class Shared(Turbulence):
    """Gusts that all vehicles of an episode share, and that grow to the north."""

    reads: ClassVar[tuple[str, ...]] = ("position_ned", "seconds", "fraction", "field")
    field_ids: ClassVar[int] = 2  # type: ignore[misc]

    def draw_field(self, draw: Any) -> Any:
        return draw.normals(1)[0]

    def init(self, draw: Any) -> None:
        """Nothing to remember."""

    def step(self, state: None, *arguments: Any) -> None:
        """Nothing to remember."""

    def gust_ned(  # type: ignore[override]
        self, state: None, height_agl: Any, position_ned: Vec3, seconds: Any, fraction: Any, field: Any
    ) -> Vec3:
        return Vec3(
            field[0] * position_ned.x,
            position_ned.y + field[1],
            0.0 * height_agl + seconds.astype(fraction.dtype) + fraction,
        )


def test_a_gust_may_need_place_time_and_what_an_episode_has_drawn() -> None:
    world = replace(qrsim.load_scenario("hover_ideal").world(), turbulence=Shared())
    keys = ticks.keys_of(world, Key.root(jnp.array([1, 0], jnp.uint32)))
    field = draw_field(world, episode_draws(world, keys, jnp.zeros(())))
    assert field.shape == (2,)
    assert len(set(field.tolist())) == 2
    place = Vec3(jnp.array([3.0]), jnp.array([4.0]), jnp.array([-20.0]))
    gust = gust_at(world, field, None, jnp.array([20.0]), place, (jnp.int32(1), jnp.float32(0.5)))
    np.testing.assert_allclose(gust.stack(), [[3.0 * field[0], 4.0 + field[1], 1.5]], rtol=1e-6)
    assert gust_rates_at(world, field, None, jnp.array([20.0]), place, (jnp.int32(1), jnp.float32(0.5))) is None
    state = jax.eval_shape(ticks.reset, world, keys)
    assert state.field.shape == (2,)
    # It fails where a tick hands it less than what it reads.
    jax.eval_shape(lambda *at: ticks.step(*at, (None,) * len(world.fleets)), world, state, jnp.int32(3))
