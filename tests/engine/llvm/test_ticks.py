"""Ticks of whole worlds: our own machine code against XLA, alone and among others."""

from __future__ import annotations

import logging
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.engine.llvm.test_operations import by_jax, run
from tests.small_worlds import bare_pair, noisy_pair

import qrsim
from qrsim.engine import settings as configuration
from qrsim.engine.llvm import Mode
from qrsim.errors import UsageError
from qrsim.models.scene.area import nearest_squared
from qrsim.simulation.rollout import rollout
from qrsim.simulation.simulation import Simulation

SEED = 5


@pytest.fixture
def xla(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(configuration._chosen, "compiler", "xla")


@pytest.fixture(autouse=True)
def _as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(configuration._chosen, "compiler", None)


def flown(world: Any, ticks: int) -> Any:
    simulation = Simulation(world, seed=SEED)
    simulation.reset()
    simulation.step(ticks=ticks)
    return simulation.state


def everything(vehicles: int) -> dict[str, Any]:
    """Return a scenario with the full turbulence, all sensors, an obstacle and a delay."""
    content = qrsim.load_scenario("patrol_published").spec.model_dump(mode="json")
    content["world"]["turbulence"] = {"type": "dryden"}
    content["world"]["obstacles"] = [{"type": "box", "x_min": 400, "x_max": 410, "y_min": 0, "y_max": 9, "z_min": -50}]
    fleet = content["fleets"]["pelicans"]
    fleet["vehicles"] = [
        dict(fleet["vehicles"][i % 5], position_ned=[7.0 * i, 3.0 * i, -30.0]) for i in range(vehicles)
    ]
    return content


@pytest.mark.long
@pytest.mark.parametrize("vehicles", [pytest.param(1, marks=pytest.mark.nightly), 19])
def test_a_tick_is_that_of_xla(vehicles, caplog):
    """Every number of the state after 12 ticks, an epoch of the receivers among them, to a few roundings."""
    world = qrsim.load_scenario(everything(vehicles)).world()
    with caplog.at_level(logging.DEBUG, "qrsim.engine"):
        mine = flown(world, 12)
    assert not caplog.records
    qrsim.configure(compiler="xla")
    expected = flown(world, 12)
    named = jax.tree_util.tree_flatten_with_path(expected)[0]
    for (path, leaf), found in zip(named, jax.tree.leaves(mine), strict=True):
        name = jax.tree_util.keystr(path)
        # The rates of climb and the velocities of fixes are differences of roundings, divided by short times.
        rough = "height_rate" in name or "velocity" in name
        np.testing.assert_allclose(found, leaf, rtol=2e-5, atol=4e-3 if rough else 2e-4, err_msg=name)


@pytest.mark.parametrize("worlds", [1, 3, 17])
def test_a_world_is_the_same_to_the_bit_alone_and_among_others(worlds):
    """Not only its noise: all of its state, computed with vehicles or with worlds side by side."""
    world = noisy_pair().world()
    many = rollout(
        world, ticks=60, worlds=worlds, seed=SEED, record=lambda state: state.fleets[0].vehicle, record_every=60
    )
    for number in {0, worlds - 1}:
        alone = Simulation(world, seed=SEED, number=number)
        alone.reset()
        alone.step(ticks=60)
        for mine, theirs in zip(
            jax.tree.leaves(alone.state.fleets[0].vehicle), jax.tree.leaves(many.recorded), strict=True
        ):
            np.testing.assert_array_equal(mine, theirs[number, -1])


@pytest.mark.parametrize("mode", [Mode(16, False), Mode(8, False)], ids=["16", "8"])
@pytest.mark.parametrize("reach", [0.0, 0.5, 3.0, 60.0])
@pytest.mark.parametrize("count", [128, 501])
def test_the_nearest_neighbour_by_cells_is_that_by_all_pairs(count, reach, mode):
    """Wherever it is within reach, on both sides of zero; beyond, no smaller. NaN and infinity are far from all."""
    random = np.random.default_rng(count)
    points = [random.uniform(-50.0, 50.0, (2, count)).astype(np.float32) for _ in range(3)]
    points[0][0, 5], points[1][1, 7] = np.nan, np.inf
    # In one world two at one place, in the other two 0.3 m apart.
    for axis in points:
        axis[1, 9], axis[0, 20] = axis[1, 10], axis[0, 21]
    points[2][0, 20] += 0.3
    state = {"points": points, "found": np.zeros((2, count), np.float32)}

    def function(shared, state, tick):
        return {"points": state["points"], "found": nearest_squared(*state["points"], shared)}

    width = np.float32(reach)
    pairs = zip(run(function, state, mode, shared=width), by_jax(function, state, shared=width), strict=True)
    for world, (mine, theirs) in enumerate(pairs):
        near = theirs["found"] <= width * width
        assert near.any() == (reach >= 0.5 or world == 1)
        np.testing.assert_allclose(mine["found"][near], theirs["found"][near], rtol=1e-6, atol=1e-9)
        assert (mine["found"][~near] >= theirs["found"][~near] * (1.0 - 1e-6)).all()


@pytest.mark.long
def test_set_points_of_another_kind_and_the_same_numbers():
    """Two records that differ only in their type are not one program; to JAX their structures are equal."""
    found = []
    for compiler in configuration.COMPILERS:
        qrsim.configure(compiler=compiler)
        simulation = qrsim.load("free_flight", seed=SEED)
        simulation.reset()
        for setpoint in (qrsim.WaypointSetpoint, qrsim.VelocitySetpoint):
            simulation.step(setpoint.of([[0.5, -0.4, 0.2]], 0.0), ticks=8)
        found.append(simulation.truth.state)
    np.testing.assert_allclose(*found, atol=1e-4)


class TestChoice:
    @staticmethod
    def compiler() -> str:
        simulation = Simulation(bare_pair().world(), seed=SEED)
        simulation.reset()
        simulation.step()
        return simulation.compiled_by[0]

    @pytest.mark.long
    def test_xla_where_it_is_asked_for(self, xla):
        assert self.compiler() == "xla"

    def test_our_own_by_default(self):
        assert self.compiler() == "llvm"

    @pytest.mark.long
    def test_both_fly_the_same(self, xla):
        world = noisy_pair().world()
        theirs = flown(world, 50).fleets[0].vehicle.position_ned
        configuration._chosen["compiler"] = "llvm"
        mine = flown(world, 50).fleets[0].vehicle.position_ned
        for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(theirs), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-4)

    def test_an_unknown_compiler_is_named(self, monkeypatch):
        with pytest.raises(UsageError, match="compiler: 'gcc' is not known; expected one of llvm, xla"):
            qrsim.configure(compiler="gcc")
        monkeypatch.setenv("QRSIM_COMPILER", "lvm")
        with pytest.raises(UsageError, match="QRSIM_COMPILER: 'lvm' is not known"):
            configuration.uses_llvm()

    @pytest.mark.long
    @pytest.mark.filterwarnings("default::qrsim.errors.CompilerWarning")
    def test_what_cannot_be_compiled_flies_by_xla(self, caplog):
        """A policy that sorts; the same worlds with one that does not."""

        @jax.jit
        def sorting(reading):
            order = jnp.sort(reading.gnss.position_ned[:, 0])
            return jnp.zeros((2, 5)).at[:, 2].set(0.59).at[:, 4].set(12.0) + 0.0 * order[:, None]

        @jax.jit
        def plain(reading):
            return jnp.broadcast_to(jnp.array([0.0, 0.0, 0.59, 0.0, 12.0]), (2, 5))

        world = noisy_pair().world()
        with caplog.at_level(logging.DEBUG, "qrsim.engine"):
            by_xla = rollout(world, sorting, ticks=40, worlds=2, seed=SEED)
        assert "compiled by XLA" in caplog.text
        np.testing.assert_allclose(
            by_xla["position_ned"], rollout(world, plain, ticks=40, worlds=2, seed=SEED)["position_ned"], atol=1e-4
        )
