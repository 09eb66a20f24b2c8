"""Learn to keep a place in wind by proximal policy optimisation (Schulman et al. 2017).

The environment is a set of pure functions, so an iteration is two compiled programs: one flies whole episodes side by
side, each in a wind from another direction, the other takes the steps of the gradient. Nothing but JAX and qrsim is
needed: ``python examples/keep_spot_ppo.py``.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.envs import Functional

# The task keep_spot for ten seconds, commanded ten times a second, in a wind of 3 m/s from anywhere and its gusts.
OVERRIDES = (
    "duration=10",
    "task.period=0.1",
    # Nothing is paid beforehand that is given back at the end: the end is near, and the learner looks beyond it.
    "task.stake=0",
    "world.wind={type: log_shear, speed_20ft: 3.0, wind_from_deg: 0.0}",
    "world.turbulence={type: dryden_first_order, speed_20ft: 3.0}",
    "ranges=[{path: world.wind.wind_from_deg, low: 0.0, high: 360.0}]",
)
ITERATIONS, EPISODES, EPOCHS, MINIBATCHES = 80, 128, 6, 8
DISCOUNT, TRACE, CLIP, RATE, VALUE_WEIGHT, MOST_GRADIENT = 0.97, 0.95, 0.2, 2e-3, 0.5, 0.5
# Seeds from here on are of episodes that nothing is learned from.
NEW = 10**6
# Rewards are learned from in units of this, of which a crash costs some eight.
UNIT = 100.0
# Pitch, roll, throttle, yaw rate and battery of a hover, and how far one unit of the policy goes from there; [-1, 1].
HOVER = np.array([0.0, 0.0, 0.0, 0.0, 1.0], np.float32)
REACH = np.array([0.3, 0.3, 0.2, 0.05], np.float32)
ACTIONS, FEATURES, WIDTH = 4, 8, 64


class Learner(NamedTuple):
    """Weights of policy and value, their running moments for Adam, and the number of gradient steps."""

    weights: Any
    first: Any
    second: Any
    count: Array


class Steps(NamedTuple):
    """What happened, (T, B) each."""

    features: Array
    action: Array
    log_probability: Array
    value: Array
    reward: Array
    alive: Array
    terminated: Array


def dense(key: Array, sizes: tuple[int, ...], last: float) -> list[tuple[Array, Array]]:
    """Return the layers of a network."""
    scales = [*(1.0 / np.sqrt(size) for size in sizes[:-2]), last]
    keys = jax.random.split(key, len(scales))
    shapes = itertools.pairwise(sizes)
    return [
        (scale * jax.random.normal(one, shape), jnp.zeros(shape[1]))
        for one, scale, shape in zip(keys, scales, shapes, strict=True)
    ]


def network(layers: list[tuple[Array, Array]], x: Array) -> Array:
    """Return what a network makes of features (..., F)."""
    for matrix, offset in layers[:-1]:
        x = jnp.tanh(x @ matrix + offset)
    return x @ layers[-1][0] + layers[-1][1]


def begin(seed: int) -> Learner:
    """Return a learner that knows nothing: its policy is to hover, with some noise."""
    keys = jax.random.split(jax.random.key(seed))
    weights = {
        "policy": dense(keys[0], (FEATURES, WIDTH, WIDTH, ACTIONS), 1e-3),
        "value": dense(keys[1], (FEATURES, WIDTH, WIDTH, 1), 1e-3),
        "log_std": jnp.full(ACTIONS, -0.5, jnp.float32),
    }
    zeros = jax.tree.map(jnp.zeros_like, weights)
    return Learner(weights, zeros, zeros, jnp.zeros(()))


def features_of(seen: Array) -> Array:
    """Return what the policy looks at, (..., 8), of what the vehicle sees, (..., 12): all as seen along its heading."""
    north, east, down = seen[..., 9], seen[..., 10], seen[..., 11]
    velocity, roll, pitch, yaw = seen[..., 3:6], seen[..., 6], seen[..., 7], seen[..., 8]
    cos, sin = jnp.cos(yaw), jnp.sin(yaw)
    place = (cos * north + sin * east, cos * east - sin * north, down)
    moving = (
        cos * velocity[..., 0] + sin * velocity[..., 1],
        cos * velocity[..., 1] - sin * velocity[..., 0],
        velocity[..., 2],
    )
    return jnp.clip(jnp.stack([*place, *moving, 4.0 * roll, 4.0 * pitch], axis=-1) / 2.0, -5.0, 5.0)


def commanded(action: Array) -> Array:
    """Return what the environment takes, (..., 1, 5), of what the policy says, (..., 4)."""
    flown = HOVER[:ACTIONS] + REACH * action
    battery = jnp.broadcast_to(HOVER[ACTIONS:], (*action.shape[:-1], 1))
    return jnp.clip(jnp.concatenate([flown, battery], axis=-1), -1.0, 1.0)[..., None, :]


def log_probability(weights: Any, mean: Array, action: Array) -> Array:
    """Return the logarithm of the density of actions (..., 4)."""
    away = (action - mean) * jnp.exp(-weights["log_std"])
    return -jnp.sum(0.5 * away**2 + weights["log_std"], axis=-1)


def fly(env: Functional, weights: Any, seeds: Array, key: Array, noise: float = 1.0) -> Steps:
    """Fly one whole episode of each seed (B,); with noise 0 by the mean of the policy."""
    episode, seen = jax.vmap(env.reset)(seeds)

    def step(now: tuple[Any, Array, Array], number: Array) -> tuple[Any, Steps]:
        episode, seen, alive = now
        looked = features_of(seen[:, 0])
        mean, value = network(weights["policy"], looked), network(weights["value"], looked)[:, 0]
        drawn = jax.random.normal(jax.random.fold_in(key, number), mean.shape)
        action = mean + noise * jnp.exp(weights["log_std"]) * drawn
        episode, found = jax.vmap(env.step)(episode, commanded(action))
        ended = alive & found.terminated
        # What comes after the end has no meaning; nothing is learned from it.
        reward = jnp.where(alive, found.reward[:, 0], 0.0)
        row = Steps(looked, action, log_probability(weights, mean, action), value, reward, alive, ended)
        return (episode, jnp.where(alive[:, None, None], found.observation, seen), alive & ~ended), row

    start = (episode, seen, jnp.ones(seeds.shape, bool))
    return jax.lax.scan(step, start, jnp.arange(env.play.steps))[1]


def advantages(steps: Steps) -> Array:
    """Return generalised advantages (T, B)."""
    reward = steps.reward / UNIT

    def back(later: tuple[Array, Array], row: tuple[Array, Array, Array]) -> tuple[tuple[Array, Array], Array]:
        advantage, value_after = later
        reward, value, terminated = row
        goes_on = jnp.where(terminated, 0.0, DISCOUNT)
        advantage = reward + goes_on * value_after - value + goes_on * TRACE * advantage
        return (advantage, value), advantage

    last = (jnp.zeros_like(reward[0]), steps.value[-1])
    return jax.lax.scan(back, last, (reward, steps.value, steps.terminated), reverse=True)[1]


def loss(weights: Any, steps: Steps, advantage: Array, target: Array) -> Array:
    """Return what is minimised, over a minibatch."""
    mean = network(weights["policy"], steps.features)
    ratio = jnp.exp(log_probability(weights, mean, steps.action) - steps.log_probability)
    gain = jnp.minimum(ratio * advantage, jnp.clip(ratio, 1.0 - CLIP, 1.0 + CLIP) * advantage)
    wrong = network(weights["value"], steps.features)[:, 0] - target
    counts = steps.alive / jnp.maximum(jnp.sum(steps.alive), 1.0)
    return jnp.sum(counts * (VALUE_WEIGHT * wrong**2 - gain))


def descend(learner: Learner, slope: Any) -> Learner:
    """Return the learner after a step of Adam."""
    size = jnp.sqrt(sum(jnp.sum(leaf**2) for leaf in jax.tree.leaves(slope)))
    slope = jax.tree.map(lambda leaf: leaf * jnp.minimum(1.0, MOST_GRADIENT / (size + 1e-9)), slope)
    count = learner.count + 1.0
    first = jax.tree.map(lambda old, new: 0.9 * old + 0.1 * new, learner.first, slope)
    second = jax.tree.map(lambda old, new: 0.999 * old + 0.001 * new**2, learner.second, slope)
    rate = RATE * jnp.sqrt(1.0 - 0.999**count) / (1.0 - 0.9**count)
    weights = jax.tree.map(lambda w, m, v: w - rate * m / (jnp.sqrt(v) + 1e-8), learner.weights, first, second)
    return Learner(weights, first, second, count)


@jax.jit
def learn(learner: Learner, steps: Steps, key: Array) -> Learner:
    """Return what a learner makes of the episodes that it has flown."""
    advantage = advantages(steps)
    target = advantage + steps.value
    spread = jnp.std(advantage, where=steps.alive) + 1e-8
    advantage = (advantage - jnp.mean(advantage, where=steps.alive)) / spread
    rows = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), (steps, advantage, target))

    def epoch(learner: Learner, key: Array) -> tuple[Learner, None]:
        order = jax.random.permutation(key, len(rows[1])).reshape(MINIBATCHES, -1)

        def minibatch(learner: Learner, chosen: Array) -> tuple[Learner, None]:
            slope = jax.grad(loss)(learner.weights, *jax.tree.map(lambda leaf: leaf[chosen], rows))
            return descend(learner, slope), None

        return jax.lax.scan(minibatch, learner, order)

    return jax.lax.scan(epoch, learner, jax.random.split(key, EPOCHS))[0]


def train(pilot: Any, seed: int, iterations: int, episodes: int) -> Iterator[tuple[Learner, Array]]:
    """Yield, after each iteration, the learner and the return of each episode (B,) that it flew.

    Args:
        pilot: ``fly`` in its environment, compiled.
        seed: of the learner.
        iterations: how many.
        episodes: in each, which nobody has flown before.
    """
    learner, root = begin(seed), jax.random.key(seed)
    for number in range(iterations):
        seeds = jnp.arange(episodes, dtype=jnp.uint32) + jnp.uint32(episodes * number)
        keys = jax.random.split(jax.random.fold_in(root, number))
        steps = pilot(learner.weights, seeds, keys[0], 1.0)
        learner = learn(learner, steps, keys[1])
        yield learner, jnp.sum(steps.reward, axis=0)


def tried(pilot: Any, weights: Any, episodes: int) -> tuple[Array, Array]:
    """Return the returns of new episodes (B,), flown by the mean of the policy, and which of them were lost."""
    seeds = jnp.arange(NEW, NEW + episodes, dtype=jnp.uint32)
    steps = pilot(weights, seeds, jax.random.key(0), 0.0)
    return jnp.sum(steps.reward, axis=0), jnp.any(steps.terminated, axis=0)


def hover() -> Any:
    """Return the weights of a policy that always commands a hover."""
    return jax.tree.map(jnp.zeros_like, begin(0).weights)


def main() -> None:
    """Learn, tell how it goes, and try what was learned in episodes that are new to it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--iterations", type=int, default=ITERATIONS, help=f"how many (default: {ITERATIONS})")
    parser.add_argument("--episodes", type=int, default=EPISODES, help=f"in each (default: {EPISODES})")
    parser.add_argument("--seed", type=int, default=0, help="of the learner (default: 0)")
    chosen = parser.parse_args()
    pilot = jax.jit(partial(fly, Functional.of("keep_spot", OVERRIDES)))
    weights = hover()
    for number, (learner, returned) in enumerate(train(pilot, chosen.seed, chosen.iterations, chosen.episodes)):
        weights = learner.weights
        print(f"iteration {number + 1:3d}: mean return {float(returned.mean()):10.1f}", flush=True)
    for name, policy in (("hover command", hover()), ("what was learned", weights)):
        returned, lost = tried(pilot, policy, chosen.episodes)
        print(f"{name:16}: mean return {float(returned.mean()):10.1f}, {int(lost.sum())} of {len(lost)} episodes lost")


if __name__ == "__main__":
    main()
