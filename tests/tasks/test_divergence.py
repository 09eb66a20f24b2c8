"""The estimator of the Kullback-Leibler divergence, and the reference samples of puffs."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.models.scene.area import BoxArea
from qrsim.models.scene.plume import DispersionPlume, PuffPlume, PuffState, Sources, Wind
from qrsim.tasks import PlumeMapping
from qrsim.tasks.plume_mapping import PlumeMemory, divergence

pytestmark = pytest.mark.long


@pytest.mark.parametrize(("mean", "spread"), [(0.0, 1.0), (1.0, 1.0), (0.5, 2.0)])
def test_two_gaussians_have_the_divergence_of_the_closed_form(mean: float, spread: float) -> None:
    """In two dimensions: D(N(0, 1) | N(mean, spread^2)) = d (ln spread + (1 + mean^2) / (2 spread^2) - 1/2).

    The mean of 20 estimates, within four standard errors and the bias of some 0.03 that nearest neighbours of so few
    samples have.
    """
    numbers = np.random.default_rng(1)
    estimate = jax.jit(divergence)
    found = [
        float(
            estimate(
                numbers.normal(0.0, 1.0, (1500, 2)).astype(np.float32),
                numbers.normal(mean, spread, (2000, 2)).astype(np.float32),
            )
        )
        for _ in range(20)
    ]
    expected = 2.0 * (np.log(spread) + (1.0 + mean**2) / (2.0 * spread**2) - 0.5)
    assert abs(np.mean(found) - expected) < 4.0 * np.std(found) / np.sqrt(20.0) + 0.03


def test_reference_samples_have_the_mean_of_the_steady_plume() -> None:
    """Of 400 samples, 60 s apart: within four standard errors of the plume of the mean amount in the mean gap."""
    plume = cast(PuffPlume(puffs=64), np.float32)
    zero = np.zeros(1, np.float32)
    sources = Sources(Vec3(zero - 60.0, zero, zero - 20.0), zero + 1.0)  # type: ignore[arg-type]
    nothing = np.zeros((1, 64), np.float32)
    state = PuffState(sources, zero + 1.0, np.zeros(1, np.int32), nothing, nothing)  # type: ignore[arg-type]
    area = cast(BoxArea(-140.0, 140.0, -140.0, 140.0, -80.0, 0.0), np.float32)  # type: ignore[arg-type]
    wind = cast(Wind(3.0, 1.0, 0.0), np.float32)  # type: ignore[arg-type]
    places = Vec3(
        *(jnp.array(axis, jnp.float32) for axis in ([-20.0, 20.0, 60.0], [0.0, 5.0, -8.0], [-20.0, -15.0, -25.0]))
    )
    task = cast(PlumeMapping(samples=400, locations=3), np.float32)
    stream = Key.root(3).stream("x", jnp.arange(3, dtype=jnp.uint32))
    memory = PlumeMemory(places, Draw(stream, jnp.int32(1), jnp.float32(0.0)))

    @jax.jit
    def sample(state: Any) -> Any:
        return task.reference(memory, plume, state, wind, area)

    found = np.asarray(sample(state))
    steady = DispersionPlume().mean(Sources(sources.position_ned, zero + 1.3 / 5.0), places, wind)  # type: ignore[arg-type]
    error = np.abs(found.mean(axis=0) - np.asarray(steady))
    assert (error < 4.0 * found.std(axis=0) / np.sqrt(400.0)).all(), (found.mean(axis=0), steady)
    assert found.std(axis=0).min() > 0.1 * found.mean(axis=0).min()
