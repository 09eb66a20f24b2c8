"""What users write, by machine code and by XLA: the shapes of real worlds, and what the code generator hands over."""

from __future__ import annotations

import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array, lax
from tests.engine.llvm.test_operations import by_jax, run
from tests.small_worlds import bare_pair, noisy_pair

import qrsim
from qrsim.core.fastmath import rounded
from qrsim.core.noise import Key
from qrsim.core.tree import parameter, record, replace
from qrsim.core.vectors import Vec3
from qrsim.engine import settings as configuration
from qrsim.engine.by_llvm import mode_of
from qrsim.engine.llvm import Mode, UnsupportedError, tracing
from qrsim.engine.programs import forget
from qrsim.envs.functional import Functional
from qrsim.errors import CompilerWarning
from qrsim.models.atmosphere.contracts import Wind
from qrsim.simulation.rollout import rollout
from qrsim.simulation.simulation import Simulation
from qrsim.tasks import KeepSpot
from qrsim.tasks.episodes import Episodes

COUNTS = (1, 2, 7, 16, 17, 144, 1000)
# Of those, the one for which whole worlds are compiled in the long tier: beyond a vector. Other tests fly fewer.
LONG_COUNTS = [pytest.param(n, marks=() if n == 17 else pytest.mark.nightly) for n in COUNTS]


@pytest.fixture(autouse=True)
def _anew():
    forget()
    yield
    forget()


def chooses(_: Any, state: Any, tick: Any) -> Any:
    """Return what policies make of what they see: the best, who is out of range, sums, loops, norms of NaN."""
    x, y, place = state["x"], state["y"], state["place"]
    speed = jnp.abs(x) + jnp.abs(y)
    best = jnp.argmax(speed)
    near = lax.while_loop(
        lambda c: c[0] < 3, lambda c: (c[0] + 1, jnp.where(c[1] > 1.0, 0.5 * c[1], c[1])), (0, speed)
    )[1]
    return {
        "x": x.at[place].get(mode="fill", fill_value=0.25),
        "y": x.at[place].get(mode="clip") + speed[best],
        "place": place,
        "best": best + jnp.argmin(y),
        "sum": jnp.cumsum(jnp.round(x)),
        "parts": jax.ops.segment_sum(jnp.round(y), place, x.shape[0]),
        "norm": jnp.stack([jnp.linalg.norm(jnp.round(x)), jnp.linalg.norm(jnp.stack([x[0], jnp.nan]))]),
        "near": near + lax.cond(best > 0, lambda: x, lambda: y),
        "last": x.at[-1].set(7.0).at[place].add(1.0, mode="drop") + jnp.minimum(x / 0.0, 1e30),
    }


@pytest.mark.parametrize("count", COUNTS)
def test_worlds_of_every_size(count):
    """One tick, within three units of the last place, in the way a world of that size is flown."""
    random = np.random.default_rng(count)
    numbers = {
        "x": random.choice([-2.0, -0.5, 0.0, 0.25, 1.0, 3.0], (2, count)).astype(np.float32),
        "y": random.choice([-1.0, 0.5, 2.0, 2.5], (2, count)).astype(np.float32),
        "place": random.integers(-count - 3, count + 3, (2, count), np.int32),
    }
    state = dict(
        numbers,
        best=np.zeros(2, np.int32),
        sum=numbers["x"],
        parts=numbers["x"],
        near=numbers["x"],
        last=numbers["x"],
        norm=np.zeros((2, 2), np.float32),
    )
    for mode in (mode_of(count, np.dtype(np.float32)), Mode(16, True)):
        with np.errstate(all="ignore"):
            for mine, theirs in zip(run(chooses, state, mode), by_jax(chooses, state), strict=True):
                for name, wanted in theirs.items():
                    np.testing.assert_array_max_ulp(mine[name], wanted, 3) if wanted.dtype.kind == "f" else (
                        np.testing.assert_array_equal(mine[name], wanted, err_msg=name)
                    )


def test_a_function_of_the_same_name_is_another():
    """It was taken for the package's own search for neighbours."""

    @jax.jit
    def nearest_squared(x, y, z, offset):
        return x + 2.0 * y - z + offset

    def function(_, state, tick):
        return dict(state, found=nearest_squared(state["x"], state["x"], state["x"], jnp.float32(0.5)))

    state = {"x": np.linspace(-3.0, 3.0, 144, dtype=np.float32)[None], "found": np.zeros((1, 144), np.float32)}
    (mine,) = run(function, state, Mode(16, False))
    np.testing.assert_allclose(mine["found"], 2.0 * state["x"][0] + 0.5, atol=2e-6)


def test_a_minimum_is_a_minimum_and_what_is_rounded_is_not_contracted():
    def function(_, state, tick):
        a, b, c = state["a"], state["b"], state["c"]
        return dict(
            state,
            least=jnp.minimum(a, 1e30),
            tied=a * b - b * a,
            rounded=rounded(a * b) - c,
            once=a * b - c,
            gap=(p := a * b) - jnp.max(p),
        )

    a = np.array([[np.inf, 1.1, 3.3]], np.float32)
    b = np.array([[1.0, 1.3, 0.7]], np.float32)
    state = {"a": a, "b": b, "c": a * b} | dict.fromkeys(("least", "tied", "rounded", "once", "gap"), 0.0 * b)
    (mine,) = run(function, state, Mode(16, False))
    np.testing.assert_array_equal(mine["least"], np.array([1e30, 1.1, 3.3], np.float32))
    np.testing.assert_array_equal(mine["tied"][1:], 0.0)
    np.testing.assert_array_equal(mine["rounded"][1:], 0.0)
    # The rounding error of the product, which one rounding of both leaves over.
    exact = a[0, 1:].astype(float) * b[0, 1:] - (a * b)[0, 1:]
    np.testing.assert_allclose(mine["once"][1:], exact, rtol=1e-6)
    assert (exact != 0.0).all()


def test_a_world_that_does_not_take_a_branch_does_not_turn_in_its_loop():
    """The loop in the branch would never end with its numbers."""

    def function(_, state, tick):
        k = state["k"]
        found = lax.cond(k > 0, lambda: lax.while_loop(lambda c: c != 0, lambda c: c - 2, 2 * k) + 5, lambda: k * 0 - 1)
        return {"k": k, "found": found}

    def odd(_, state, tick):
        return function(_, dict(state, k=state["k"]), tick)

    state = {"k": np.array([3, -1, 4, 0, 2] * 4, np.int32), "found": np.zeros(20, np.int32)}
    found = [int(each["found"]) for each in run(odd, state, Mode(16, True))]
    assert found == [5, -1, 5, -1, 5] * 4


@pytest.mark.parametrize("mode", [Mode(16, False), Mode(16, True)])
def test_a_loop_over_a_fixed_count_turns_that_often(mode):
    """One in another, with a number that counts the turns: 1 * 2 * ... * 5 is 120."""

    def function(_, state, tick):
        def outer(i, found):
            inner = lax.fori_loop(0, 3, lambda j, x: x + state["one"], 0.0 * found)
            return found * (i + 1) * (inner / 3.0)

        return dict(state, found=lax.fori_loop(0, 5, outer, state["one"]))

    state = {"one": np.ones((2, 3), np.float32), "found": np.zeros((2, 3), np.float32)}
    for mine in run(function, state, mode):
        np.testing.assert_array_equal(mine["found"], 120.0)


@pytest.mark.parametrize(
    ("reason", "function"),
    [
        ("'sort' at", lambda x: jnp.sort(x)),
        ("'dot_general' at", lambda x: jnp.outer(x, x) @ x),
        ("a scan through arrays at", lambda x: lax.scan(lambda c, y: (c + y, y), x[0], x)[1]),
        (
            "a loop with a condition for each element at",
            jax.vmap(lambda x: lax.while_loop(lambda c: c < x, lambda c: 2.0 * c + 1.0, jnp.float32(0.0))),
        ),
        ("a scatter that applies a function", lambda x: x.at[0].apply(jnp.sin)),
        ("numbers of type float16", lambda x: x.astype(jnp.float16).astype(jnp.float32)),
    ],
)
def test_the_reason_names_operation_and_line(reason, function):
    state = {"x": np.ones((1, 4), np.float32)}
    with pytest.raises(UnsupportedError, match=reason) as caught:
        run(lambda _, now, tick: {"x": function(now["x"])}, state, Mode(16, False))
    assert "test_users.py:" in str(caught.value)


def test_numbers_that_would_be_cut_short_from_tick_to_tick_are_refused():
    with jax.enable_x64(True), pytest.raises(UnsupportedError, match="numbers of type int64 from tick to tick"):
        run(lambda _, now, tick: {"k": now["k"] + 1}, {"k": np.zeros((1, 4), np.int64)}, Mode(8, False))


class TestFallback:
    @pytest.fixture
    def broken(self, monkeypatch):
        """Let the code generator have a fault of its own."""

        def fault(*_: Any) -> Any:
            raise KeyError(12)

        monkeypatch.setattr(tracing.Tracer, "broadcast_in_dim", fault)
        monkeypatch.setenv("QRSIM_COMPILATION_CACHE", "off")

    @pytest.mark.long
    def test_a_fault_of_its_own_costs_one_warning(self, broken):
        simulation = Simulation(bare_pair().world(), seed=1)

        def fly() -> None:
            simulation.reset()
            simulation.step(ticks=3)

        with pytest.warns(CompilerWarning, match=r"error of the code generator itself \(KeyError: 12\)") as told:
            fly()
        assert len([each for each in told if each.category is CompilerWarning]) == 1
        assert simulation.tick == 3

    @pytest.mark.long
    def test_a_policy_flies_by_xla_with_one_warning(self):
        """That names what it is and where; asked again, or told to use XLA, nothing more is said."""

        @jax.jit
        def sorting(reading):
            order = jnp.sort(reading.gnss.position_ned[:, 0])
            return jnp.zeros((2, 5)).at[:, 2].set(0.59).at[:, 4].set(12.0) + 0.0 * order[:, None]

        world = noisy_pair().world()
        with pytest.warns(CompilerWarning, match=r"XLA.*does not take 'sort' at .*test_users.py:\d+") as told:
            first = rollout(world, sorting, ticks=5, worlds=2, seed=1)
        assert len([each for each in told if each.category is CompilerWarning]) == 1
        with warnings.catch_warnings():
            warnings.simplefilter("error", CompilerWarning)
            second = rollout(world, sorting, ticks=5, worlds=2, seed=1)
        np.testing.assert_array_equal(first["position_ned"], second["position_ned"])


def vehicles(name: str, count: int) -> dict[str, Any]:
    """Return a scenario with so many vehicles, 6.5 m apart."""
    content = qrsim.load_scenario(name).spec.model_dump(mode="json")
    fleet = content["fleets"]["pelicans"]
    fleet["vehicles"] = [
        dict(
            fleet["vehicles"][i % len(fleet["vehicles"])],
            position_ned=[6.5 * (i % 32) - 100.0, 6.5 * (i // 32) - 100.0, -30.0],
        )
        for i in range(count)
    ]
    content["world"]["area"] |= {"x_min": -130.0, "x_max": 130.0, "y_min": -130.0, "y_max": 130.0, "z_min": -80.0}
    return content


def by_both(monkeypatch: pytest.MonkeyPatch, fly: Any) -> list[Any]:
    """Return what comes of both compilers, neither of which may hand over."""
    found = []
    for compiler in configuration.COMPILERS:
        monkeypatch.setitem(configuration._chosen, "compiler", compiler)
        with warnings.catch_warnings():
            warnings.simplefilter("error", CompilerWarning)
            found.append(fly())
    return found


@pytest.mark.long
@pytest.mark.parametrize("count", LONG_COUNTS)
def test_policies_of_real_worlds_by_both_compilers(count, monkeypatch):
    """The chosen vehicles climb; after 5 ticks both have every vehicle where the other has it, and nobody is warned."""

    @jax.jit
    def chooses_vehicles(reading):
        place = reading.gnss.position_ned
        chosen = jnp.stack(
            [
                jnp.argmax(place[:, 0]),
                jnp.cumsum(jnp.ones(count))[-1].astype(int) - 1,
                jnp.arange(count).at[count + 5].get(mode="clip"),
                jnp.arange(count).at[count + 5].get(mode="fill", fill_value=0),
            ]
        )
        climbs = (jnp.arange(count)[:, None] == chosen[None]).any(1) & (jnp.linalg.norm(place, axis=1) > 0.0)
        zero = jnp.zeros(count)
        return jnp.stack([zero, zero, jnp.where(climbs, 0.7, 0.59), zero, zero + 12.0], axis=1)

    world = qrsim.load_scenario(vehicles("patrol_published", count)).world()
    found = by_both(monkeypatch, lambda: rollout(world, chooses_vehicles, ticks=5, seed=1)["position_ned"])
    np.testing.assert_allclose(*found, atol=2e-4)


@record
class Wake(Wind):
    """A wind of a user's: whoever is highest is in calm air, and all others feel those before them in the list."""

    strength: Array = parameter(default=4.0, unit="m/s", doc="of the wind")

    def velocity_ned(self, height_agl: Array, seconds: Array | None = None, fraction: Array | None = None) -> Vec3:
        """Return the velocity (n,) of the air."""
        count = height_agl.shape[0]
        number = jnp.arange(count)
        highest = jnp.argmax(height_agl)
        before = height_agl.at[number - 1].get(mode="clip")
        beyond = height_agl.at[number + 1].get(mode="fill", fill_value=10.0)
        north = jnp.where(number == highest, 0.0, self.strength) + 0.01 * jnp.cumsum(before - beyond) / count
        groups = jax.ops.segment_sum(height_agl, number % 3, 3) / count
        east = groups[number % 3] * lax.cond(height_agl[0] > 20.0, lambda: 0.05, lambda: 0.0)
        down = jnp.nan_to_num(jnp.linalg.norm(jnp.stack([height_agl[0], jnp.nan])), nan=0.5)
        return Vec3(north, east, jnp.broadcast_to(down, north.shape))


@pytest.mark.parametrize(
    "count",
    [
        *(pytest.param(n, marks=pytest.mark.long) for n in (1, 17)),
        *(pytest.param(n, marks=pytest.mark.nightly) for n in (2, 7, 16, 144, 1000)),
    ],
)
def test_components_of_users_by_both_compilers(count, monkeypatch):
    scenario = qrsim.load_scenario(vehicles("patrol_published", count)) if count > 1 else bare_pair()
    world = replace(scenario.world(), wind=Wake(strength=jnp.float32(4.0)))

    def fly() -> Any:
        simulation = Simulation(world, seed=1)
        simulation.reset()
        simulation.step(ticks=5)
        return simulation.truth.position_ned, simulation.state.fleets[0].mean_wind_ned.stack()

    mine, theirs = by_both(monkeypatch, fly)
    np.testing.assert_allclose(mine[0], theirs[0], atol=2e-4)
    np.testing.assert_allclose(mine[1], theirs[1], atol=2e-4)


@record
class Race(KeepSpot):
    """A task of a user's: who has come farthest wins what the others lose."""

    def judge(self, memory: Any, world: Any, state: Any, step: Array, steps: Array) -> tuple[Any, Array]:
        """Return the reward (n,) of each."""
        memory, shared = KeepSpot.judge(self, memory, world, state, step, steps)
        place = state.fleets[0].vehicle.position_ned
        count = place.x.shape[0]
        gone = place.x - memory.start_ned.x
        first = jnp.argmax(gone)
        ranks = jnp.sum(gone[:, None] < gone[None, :], axis=1) if count < 200 else jnp.cumsum(gone > 0.0)
        won = jnp.zeros(count).at[first].add(1.0).at[first - 1].add(-1.0, mode="drop") + gone[-1 - first]
        return memory, shared + won + lax.cond(step > 1, lambda: ranks.astype(gone.dtype), lambda: jnp.round(gone))


@pytest.mark.long
@pytest.mark.parametrize("count", LONG_COUNTS)
def test_tasks_of_users_by_both_compilers(count, monkeypatch):
    play = Functional.of(vehicles("keep_spot_10", count)).play
    play = replace(play, task=Race(**vars(play.task)))
    actions = np.random.default_rng(count).uniform(-0.2, 0.2, (3, 2, count, 5)).astype(np.float32)

    def fly() -> Any:
        some = Episodes(play, 2, np.dtype(np.float32))
        some.start(np.arange(2), play.keys(Key.roots(np.arange(2), np.zeros(2, np.int64))))
        steps = [some.step(action) for action in actions]
        return [step.reward for step, _ in steps], [truth["position_ned"] for _, truth in steps], some.compiler

    mine, theirs = by_both(monkeypatch, fly)
    assert {mine[2], theirs[2]} == {"llvm", "xla"}
    np.testing.assert_allclose(mine[1], theirs[1], atol=2e-4)
    np.testing.assert_allclose(mine[0], theirs[0], atol=2e-4, rtol=2e-5)
