"""Rollouts against the simulation that each of their worlds is, and what they cost."""

from __future__ import annotations

import dataclasses
import gc
import json
import os
import subprocess
import sys
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.small_worlds import bare_pair, noisy_pair

import qrsim
from qrsim.core.tree import parameter, record, replace
from qrsim.core.vectors import Vec3
from qrsim.engine.llvm.compiler import Loaded
from qrsim.errors import UsageError
from qrsim.models.atmosphere.contracts import Wind
from qrsim.simulation import rollout as rollouts
from qrsim.simulation.rollout import Rollout, rollout
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import State, World

SEED, TICKS, EVERY = 5, 200, 50
# Metres and radians: what single precision makes of the same noise in programs compiled differently.
SAME = {"rtol": 2e-5, "atol": 1e-5}


def everything(state: State) -> Any:
    """What sensors say and what is true."""
    return [(fleet.vehicle, fleet.readings, fleet.mean_wind_ned + fleet.gust_ned) for fleet in state.fleets]


def place(state: State) -> Any:
    """True positions (n, 3)."""
    return jnp.stack(jax.tree.leaves(state.fleets[0].vehicle.position_ned), axis=-1)


def assert_alike(found: Any, expected: Any, **tolerance: float) -> None:
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, **SAME | tolerance), found, expected)


def simulated(world: World, **options: Any) -> Any:
    """Everything of a simulation at every EVERY-th tick up to TICKS, each leaf (R, ...)."""
    flying = Simulation(world, **options)
    flying.reset()
    states = [everything(flying.state)]
    for _ in range(TICKS // EVERY):
        flying.step(ticks=EVERY)
        states.append(everything(flying.state))
    return jax.tree.map(lambda *leaves: np.stack(leaves), *states)


def of_world(flown: Rollout, number: int) -> Any:
    return jax.tree.map(lambda leaf: leaf[number], flown.recorded)


@contextmanager
def lowerings() -> Iterator[list[str]]:
    """Notes every program that is made for the compiler, found in a cache or not."""
    found: list[str] = []

    def note(event: str, duration: float, **_: Any) -> None:
        if event == "/jax/core/compile/jaxpr_to_mlir_module_duration":
            found.append(event)

    load = Loaded.__init__

    def noted(self: Loaded, code: bytes) -> None:
        found.append("native")
        load(self, code)

    jax.monitoring.register_event_duration_secs_listener(note)
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Loaded, "__init__", noted)
            yield found
    finally:
        jax.monitoring.unregister_event_duration_listener(note)


@pytest.fixture(scope="module")
def world() -> World:
    return noisy_pair().world()


@pytest.fixture(scope="module")
def bare() -> World:
    return bare_pair().world()


@pytest.fixture(scope="module")
def seven(world: World) -> Rollout:
    return rollout(world, ticks=TICKS, worlds=7, seed=SEED, record=everything, record_every=EVERY)


class TestWorldsAreSimulations:
    @pytest.mark.parametrize("number", [0, 6])
    def test_by_number(self, world, seven, number: int):
        assert (seven.seeds[number], seven.numbers[number]) == (SEED, number)
        np.testing.assert_array_equal(seven.record_ticks, np.arange(0, TICKS + 1, EVERY))
        assert_alike(of_world(seven, number), simulated(world, seed=SEED, number=number))

    def test_worlds_differ_from_each_other(self, seven):
        vehicle, readings, air = seven.recorded[0]
        for leaf in (vehicle.position_ned.x[:, -1, 0], readings[0].position_ned.x[:, 0, 0], air.x[:, 0, 1]):
            assert len(np.unique(leaf)) == 7

    def test_however_cut_into_blocks_and_however_many(self, world, seven, monkeypatch):
        """Seven worlds as 3 + 3 + 1 that is filled up, and three without the others."""
        done: list[int] = []
        options: dict[str, Any] = {"ticks": TICKS, "seed": SEED, "record": everything, "record_every": EVERY}
        few = rollout(world, worlds=3, **options)
        monkeypatch.setattr(rollouts, "VEHICLES_PER_BLOCK", 6)
        with lowerings() as made:
            cut = rollout(world, worlds=7, progress=done.append, **options)
        assert made == []
        assert sum(done) == 7 * TICKS
        assert_alike(cut.recorded, seven.recorded)
        assert_alike(few.recorded, jax.tree.map(lambda leaf: leaf[:3], seven.recorded))
        assert cut.metrics.keys() == seven.metrics.keys()
        for name in cut.metrics:
            assert cut[name].shape[:2] == (7, 2)
            if not name.endswith("_at_s"):
                np.testing.assert_allclose(cut[name], seven[name], rtol=1e-4, atol=1e-4, err_msg=name)

    def test_by_seeds(self, world, seven):
        seeds = [2**40 + 1, SEED, 9]
        flown = rollout(world, ticks=TICKS, seeds=seeds, record=everything, record_every=EVERY)
        np.testing.assert_array_equal(flown.seeds, seeds)
        np.testing.assert_array_equal(flown.numbers, 0)
        assert_alike(of_world(flown, 0), simulated(world, seed=seeds[0]))
        assert_alike(of_world(flown, 1), of_world(seven, 0))

    @pytest.mark.long
    def test_worlds_of_their_own_numbers(self, bare):
        """Mass and area differ; the area of the last one is too small for its route."""
        heavy = bare_pair(vehicle={"type": "pelican", "mass": 2.0})
        narrow = bare_pair(
            area={"type": "box", "x_min": -4.0, "x_max": 6.1, "y_min": -20.0, "y_max": 20.0, "z_min": -40.0},
            vehicles=[
                {"position_ned": [0, 0, -10], "velocity_body": [8, 0, 0], "waypoints_ned": [[6, 0, -10], [6, 5, -11]]},
                {"position_ned": [0, 9, -12], "waypoints_ned": [[6, 9, -12]]},
            ],
        )
        worlds = [bare, heavy.world(), narrow.world()]
        flown = rollout(worlds, ticks=TICKS, seed=SEED, record=everything, record_every=EVERY)
        np.testing.assert_array_equal(flown.numbers, [0, 1, 2])
        for number, own in enumerate(worlds):
            assert_alike(of_world(flown, number), simulated(own, seed=SEED, number=number))
        assert flown.reasons(1) == ["", ""]
        assert flown.reasons(2)[0].startswith("out_of_area: position_ned.x = 6.1")
        assert flown["position_ned"][1, 0, 2] > flown["position_ned"][0, 0, 2] + 0.1  # the heavier sinks

    @pytest.mark.long
    def test_on_two_devices(self, bare, tmp_path):
        """Three worlds, so that one device has a world to itself, and the other a world twice."""
        program = """
import sys, numpy as np, jax, qrsim
from tests.small_worlds import bare_pair
qrsim.configure(cpu_devices=2)
assert len(jax.devices()) == 2
flown = qrsim.rollout(bare_pair().world(), ticks=200, worlds=3, seed=5, record=lambda s: s.fleets[0].vehicle.thrust)
np.savez(sys.argv[1], recorded=flown.recorded, **flown.metrics)
try:
    qrsim.configure(cpu_devices=3)
except qrsim.errors.UsageError as error:
    assert "already started with 2" in str(error)
else:
    raise SystemExit("cpu_devices changed after the start")
"""
        in_process(program, str(tmp_path / "found.npz"))
        found = np.load(tmp_path / "found.npz")
        alone = rollout(bare, ticks=TICKS, worlds=3, seed=SEED, record=lambda s: s.fleets[0].vehicle.thrust)
        np.testing.assert_allclose(found["recorded"], alone.recorded, rtol=1e-5)
        for name in ("position_ned", "distance_m", "tracking_error_rms_m", "separation_min_m", "flown_s"):
            np.testing.assert_allclose(found[name], alone[name], rtol=1e-4, atol=1e-5, err_msg=name)


def in_process(program: str, *arguments: str) -> str:
    """Run a program of its own and return what it prints."""
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        cwd=root, env={**os.environ, "PYTHONPATH": str(root)}, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


class TestStructure:
    def test_worlds_of_another_structure_are_refused(self, bare, world):
        with pytest.raises(UsageError, match="number 1 differs from number 0 in more than numbers: types"):
            rollout([bare, world], ticks=1)
        with pytest.raises(UsageError, match=r"is float64 \(.*\), not float32 \("):
            rollout([bare, bare_pair().world("float64")], ticks=1)
        masses = bare_pair(vehicle={"type": "pelican", "mass": [2.0, 1.5]}).world()
        with pytest.raises(UsageError, match=r"fleets\[0\].vehicle.mass is float32 \(2,\), not float32 \(\)"):
            rollout([bare, masses], ticks=1)
        renamed = replace(bare, fleets=(replace(bare.fleets[0], vehicle_names=("a", "b")),))
        with pytest.raises(UsageError, match="number 2"):
            rollout([bare, bare, renamed], ticks=1)

    def test_a_fleet_of_100_masses_compiles_once(self):
        """In a rollout and in a simulation; another hundred masses compile nothing."""

        def fleet(lightest: float) -> World:
            places = [[10.0 * (i // 10), 10.0 * (i % 10), -20.0] for i in range(100)]
            masses = np.linspace(lightest, 1.9, 100)
            return bare_pair(vehicles=places, vehicle={"type": "pelican", "mass": masses}, area="box").world()

        first, second = fleet(1.5), fleet(1.4)
        heights = []
        for i, own in enumerate((first, second)):
            with lowerings() as made:
                flown = rollout(own, ticks=100, worlds=2, seed=SEED)
                single = Simulation(own, seed=SEED)
                single.reset()
                single.step(ticks=100)
            assert bool(made) == (i == 0)
            heights.append(-flown["position_ned"][0, :, 2])
            np.testing.assert_allclose(single.truth.position_ned, flown["position_ned"][0], **SAME)
        # The lighter the higher, vehicle by vehicle.
        assert np.corrcoef(np.arange(100), heights[0])[0, 1] < -0.9
        assert np.all(heights[1][:50] > heights[0][:50])

    def test_another_thing_to_record_compiles_nothing_else(self, bare):
        rollout(bare, ticks=4, worlds=3, record=lambda state: state.fleets[0].vehicle.thrust)
        with lowerings() as made:
            rollout(bare, ticks=4, worlds=3, record=lambda state: state.fleets[0].vehicle.attitude.yaw)
        assert len(made) == 1


class TestRecords:
    def test_shapes_and_the_start(self, bare):
        """Every 30th of 100 ticks, the start included, the end not."""
        flown = rollout(
            bare, ticks=100, worlds=3, record_every=30, record=lambda state: {"place": place(state), "n": jnp.int32(2)}
        )
        np.testing.assert_array_equal(flown.record_ticks, [0, 30, 60, 90])
        assert flown.recorded["place"].shape[:2] == (3, 4)
        np.testing.assert_array_equal(flown.recorded["n"], np.full((3, 4), 2))
        np.testing.assert_array_equal(flown.recorded["place"][:, 0], [[[0.0, 0.0, -10.0], [0.0, 9.0, -12.0]]] * 3)

    def test_a_sink_takes_all_and_nothing_is_kept(self, bare, monkeypatch):
        def thrust(state: State) -> Any:
            return state.fleets[0].vehicle.thrust

        monkeypatch.setattr(rollouts, "VEHICLES_PER_BLOCK", 6)
        kept = rollout(bare, ticks=40, worlds=5, seed=SEED, record=thrust, record_every=20)
        got: dict[tuple[int, int], Any] = {}

        def sink(numbers: Any, tick: int, recorded: Any) -> None:
            assert recorded.shape == (len(numbers), 2)
            got.update({(int(number), tick): row for number, row in zip(numbers, recorded, strict=True)})

        flown = rollout(bare, ticks=40, worlds=5, seed=SEED, record=thrust, record_every=20, sink=sink)
        assert flown.recorded is None
        assert sorted(got) == [(number, tick) for number in range(5) for tick in (0, 20, 40)]
        for (number, tick), row in got.items():
            np.testing.assert_allclose(row, kept.recorded[number, tick // 20], rtol=1e-5)

    def test_without_a_record_there_is_none(self, bare):
        flown = rollout(bare, ticks=4, worlds=3)
        assert flown.recorded is None
        assert len(flown.record_ticks) == 0

    def test_metrics_of_ones_own(self, bare):
        class Highest:
            def init(self, world: World, state: State) -> Any:
                return -state.fleets[0].vehicle.position_ned.z

            def update(self, memory: Any, world: World, state: State, tick: Any) -> Any:
                return jnp.maximum(memory, -state.fleets[0].vehicle.position_ned.z)

            def finish(self, memory: Any, world: World, state: State) -> dict[str, Any]:
                return {"highest_m": memory}

        flown = rollout(
            bare, ticks=100, worlds=3, seed=SEED, metrics=Highest(), record_every=1,
            record=lambda state: -state.fleets[0].vehicle.position_ned.z,
        )  # fmt: skip
        assert list(flown.metrics) == ["highest_m"]
        np.testing.assert_allclose(flown["highest_m"], flown.recorded.max(axis=1), rtol=1e-6)
        with pytest.raises(UsageError, match="did you mean 'highest_m'"):
            _ = flown["higest_m"]


class TestBlocks:
    @pytest.mark.parametrize(
        ("count", "vehicles", "devices", "per_world"),
        [(1, 1, 1, 100), (7, 2, 2, 100), (10_000, 5, 2, 3000), (3, 9000, 1, 10), (50, 1, 3, 2**26), (5, 1, 8, 2**40)],
    )
    def test_every_world_once_within_the_limits(self, count: int, vehicles: int, devices: int, per_world: int):
        engine: Any = SimpleNamespace(names=["v"] * vehicles, devices=devices, bytes_per_world=lambda: per_world)
        found = list(rollouts._blocks(engine, count))
        assert len({len(rows) for rows in found}) == 1
        assert len(found[0]) % devices == 0
        on_each = len(found[0]) // devices
        assert on_each == 1 or on_each * vehicles <= rollouts.VEHICLES_PER_BLOCK
        assert on_each == 1 or len(found[0]) * per_world * rollouts.COPIES <= rollouts.MEMORY_BYTES
        np.testing.assert_array_equal(np.unique(np.concatenate(found)), np.arange(count))
        assert sum(len(np.unique(rows)) for rows in found) == count


class TestMemory:
    @pytest.mark.long
    def test_many_worlds_stay_small(self):
        """4096 worlds of one noisy vehicle below 2 GiB; as many again, in a second block, add little."""
        program = """
import json, qrsim
from evidence._processes import peak_bytes
from qrsim.scenarios.scenario import load_scenario
world, peaks = load_scenario("keep_spot").world(), []
for worlds in (4096, 8192):
    flown = qrsim.rollout(world, ticks=20, worlds=worlds)
    assert flown["distance_m"].shape == (worlds, 1)
    peaks.append(peak_bytes() / 2**20)
print(json.dumps(peaks))
"""
        first, second = json.loads(in_process(program))
        assert first < 2048.0
        assert second - first < 300.0


class TestBadInput:
    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"ticks": 0}, "ticks: 0 is not a positive whole number"),
            ({"ticks": 2.0}, "ticks: 2.0"),
            ({"ticks": True}, "ticks: True"),
            ({"ticks": 2**31}, "would pass the last tick"),
            ({"ticks": 1, "worlds": 0}, "worlds: 0"),
            ({"ticks": 1, "worlds": "many"}, "worlds: 'many'"),
            ({"ticks": 1, "seed": -1}, "seed: -1 is not an integer"),
            ({"ticks": 1, "seed": 2**63}, "seed: 9223372036854775808"),
            ({"ticks": 1, "seed": 1.5}, "seed: 1.5"),
            ({"ticks": 1, "seeds": []}, "seeds: an empty list"),
            ({"ticks": 1, "seeds": 10}, r"seeds: expected one for each world, such as range\(10\), found 10"),
            ({"ticks": 1, "seeds": [1, -2]}, "seed: -2"),
            ({"ticks": 1, "seeds": [1, 2], "worlds": 3}, "worlds: 3, but a list of 2"),
            ({"ticks": 1, "policy_ticks": 0}, "policy_ticks: 0"),
            ({"ticks": 1, "record": everything, "record_every": 0}, "record_every: 0"),
            ({"ticks": 1, "sink": print}, "sink: there is nothing to hand to it"),
        ],
    )
    def test_numbers(self, bare, options: dict[str, Any], message: str):
        with pytest.raises(UsageError, match=message):
            rollout(bare, **options)

    def test_lists(self, bare):
        with pytest.raises(UsageError, match="an empty list has no world"):
            rollout([], ticks=1)
        with pytest.raises(UsageError, match="worlds: 3, but a list of 2"):
            rollout([bare, bare], ticks=1, worlds=3)
        with pytest.raises(UsageError, match="seeds: 3 for 2 worlds"):
            rollout([bare, bare], ticks=1, seeds=[1, 2, 3])


def test_what_is_public():
    assert qrsim.rollout.__module__ == "qrsim.scenarios.flying"
    assert qrsim.Rollout.__module__ == "qrsim.simulation.rollout"
    assert dataclasses.fields(qrsim.Rollout)


def test_classes_of_one_name_are_not_one() -> None:
    """As two files of a user may have them: what the second does was computed by the first."""

    def gale(speed: float) -> Any:
        @record
        class Gale(Wind):
            factor: Any = parameter(1.0, unit="1", doc="a factor")

            def velocity_ned(self, height_agl: Any, seconds: Any, fraction: Any) -> Vec3:
                like = jnp.zeros_like(height_agl)
                return Vec3(like + speed * self.factor, like, like)

        return Gale(jnp.float32(1.0))

    worlds = [replace(bare_pair().world(), wind=gale(speed)) for speed in (1.0, 2.0)]
    with pytest.raises(UsageError, match="number 1 differs from number 0 in more than numbers: types"):
        rollout(worlds, ticks=2)


def test_what_is_asked_for_by_another_name_is_a_sentence(seven: Rollout) -> None:
    assert set(seven) == set(seven.metrics)
    with pytest.raises(UsageError, match=r"a rollout has metrics by name, each \(W, n\), and no number 0"):
        seven[0]  # type: ignore[index]
    with pytest.raises(UsageError, match=r"world: 7 is none of this rollout; allowed: an integer from 0 to 6"):
        seven.reasons(7)


def test_a_policy_that_was_compiled_is_not_kept(bare) -> None:
    class Policy:
        def init(self, reading: Any) -> Any:
            return ()

        def step(self, reading: Any, memory: Any) -> Any:
            return None, memory

    policy = Policy()
    seen = weakref.ref(policy)
    rollout(bare, policy, ticks=2)
    del policy
    gc.collect()
    assert seen() is None
