"""The work of a worker: flying a batch."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import QrsimError
from qrsim.studies.sweep.job import Job, goals
from qrsim.studies.sweep.metrics import METRICS, Metric, of_episodes
from qrsim.studies.sweep.plan import TRACK
from qrsim.world.state import period_ticks

if TYPE_CHECKING:
    from qrsim.studies.sweep.groups import Group
    from qrsim.world.state import State

# The engine keeps its programs in one place for a process.
_ALONE = threading.Lock()


def fly(job: Job, threads: int = 1) -> dict[str, NumpyArray] | str:
    """Fly a batch of W episodes; return name -> metric (W,), or a text that says why it cannot be flown."""
    from qrsim.engine.settings import configure

    with _ALONE:
        # A process that has computed something already keeps the devices it has.
        with suppress(QrsimError):
            configure(cpu_devices=threads)
        try:
            from qrsim.studies.sweep.study import BASELINE

            if job.policy == BASELINE:
                from qrsim.studies.sweep.playing import play

                found = play(_group(job.group), job)
            else:
                found = _roll_out(job)
            kept = {} if job.track is None else {TRACK: found[TRACK]}
            return {**kept, **of_episodes(job.metrics, found, _own_metrics(job)[1])}
        except QrsimError as error:
            return str(error)


@lru_cache(maxsize=8)
def _group(dumped: bytes) -> Group:
    """Unpickle a ``Group`` in a worker, after loading components that are not built in; cached for the next batches."""
    from qrsim.errors import UsageError
    from qrsim.scenarios.providing import provide_components

    content, pickled = pickle.loads(dumped)
    # Classes from outside are in no module that a worker has yet.
    provide_components(content, "scenario")
    try:
        return pickle.loads(pickled)
    except (ImportError, AttributeError) as error:
        raise UsageError(f"a worker has another file of a component from outside, or it was changed: {error}") from None


def dumped(group: Group) -> bytes:
    """Serialise a ``Group`` to bytes for another process."""
    return pickle.dumps((group.content, pickle.dumps(group)))


@lru_cache(maxsize=8)
def _function(what: str, source: str, digest: str) -> Any:
    """Load a user's function by its source; all batches get the same object, so that JAX compiles it once."""
    from pathlib import Path

    from qrsim.errors import UsageError
    from qrsim.interface.policies import load_function
    from qrsim.studies.sweep.own_metrics import own_metrics
    from qrsim.studies.sweep.study import OWN, digest_of

    if digest_of(what, source) != digest:
        raise UsageError(f"{what} {source}: a worker has another file of that name, or it was changed; in {Path.cwd()}")
    return own_metrics(source) if what == OWN else load_function(what, source)


def _own_metrics(job: Job) -> tuple[Any, Mapping[str, Metric]]:
    """Load the user's metrics object of a job; return it, and name -> ``Metric``."""
    from qrsim.studies.sweep.study import OWN

    if job.own_metrics is None:
        return None, {}
    found: tuple[Any, Mapping[str, Metric]] = _function(OWN, job.own_metrics, dict(job.code)[OWN])
    return found


def _roll_out(job: Job) -> dict[str, NumpyArray]:
    """Fly the W worlds of a batch in parallel; return name -> metric (W,)."""
    import jax

    from qrsim.engine.settings import use_compilation_cache
    from qrsim.interface.mission_metrics import MISSION_METRICS
    from qrsim.simulation.blocks import Engine, Schedule
    from qrsim.simulation.rollout import setup_of

    use_compilation_cache()
    group = _group(job.group)
    code = dict(job.code)
    given = {"policy": job.policy, "estimator": job.estimator}
    functions: dict[str, Any] = {what: source and _function(what, source, code[what]) for what, source in given.items()}
    own_metrics, _ = _own_metrics(job)
    missions = any(name in METRICS and METRICS[name].mission for name in job.metrics)
    if own_metrics is not None:
        functions["metrics"] = _beside_built_in(own_metrics, missions)
    elif missions:
        functions["metrics"] = MISSION_METRICS
    with jax.enable_x64(job.precision == "float64"):
        if group.places is None:
            worlds = group.loaded(job.numbers, job.precision)
            setup, fixed, own = setup_of(worlds, **functions, policy_ticks=job.policy_ticks)
        else:
            setup, fixed, own = _stacked(group, job, functions)
        every = 0 if job.track is None else period_ticks(job.track, group.time_step)
        record = _recorder(job.group) if every else None
        engine = Engine(setup, group.world, fixed, own, Schedule(group.ticks, every), record, None, lambda done: None)
        found, recorded = engine.fly(np.arange(len(job.seeds)), job.seeds, np.zeros_like(job.seeds))
    if every:
        found = {**found, TRACK: _until_the_end(np.stack(recorded, axis=-1), found["flown_s"], every * group.time_step)}
    if "end_error_m" not in job.metrics:
        return found
    rows = [setup.world(fixed, [part[i] for part in own]) for i in range(len(job.seeds))] if own else [group.world]
    return {**found, "goal_ned": np.stack([goals(world) for world in rows])}


@lru_cache(maxsize=8)
def _beside_built_in(own_metrics: object, missions: bool) -> Any:
    """Return an object with built-in (``missions``: also of missions) and user's metrics, the same for all batches."""
    from qrsim.interface.metrics import FLIGHT_METRICS
    from qrsim.interface.mission_metrics import MISSION_METRICS
    from qrsim.studies.sweep.own_metrics import BothMetrics

    return BothMetrics(MISSION_METRICS if missions else FLIGHT_METRICS, own_metrics)


@lru_cache(maxsize=8)
def _recorder(dumped: bytes) -> Any:
    """Return a function that maps a state to a track record; the same for all batches of a group."""
    import jax.numpy as jnp

    from qrsim.interface.endurance import charges

    world = _group(dumped).world

    def place(state: State) -> object:
        """Return north, east, down [m] and battery charge (0 to 1) of all vehicles."""
        positions = [fleet.vehicle.position_ned for fleet in state.fleets]
        axes = [jnp.concatenate([getattr(position, axis) for position in positions]) for axis in "xyz"]
        return (*axes, charges(world, state))

    return place


def _until_the_end(tracks: NumpyArray, flown_s: NumpyArray, every: float) -> NumpyArray:
    """Return tracks (W, R, n, 4) with NaN after each run's longest flight; ``every`` [s] separates R records."""
    time = np.arange(tracks.shape[1]) * every
    late = time[None, :] > np.max(flown_s, axis=1)[:, None] + 1e-3
    return np.where(late[..., None, None], np.nan, tracks).astype(np.float32)


def _stacked(group: Group, job: Job, functions: dict[str, Any]) -> Any:
    """Return a rollout's set-up, world leaves shared by all episodes, and leaves (W, ...) that vary."""
    from dataclasses import replace

    import jax.numpy as jnp

    from qrsim.simulation.rollout import setup_of

    structure, fixed, own, which = group.varied(job.numbers)
    setup, _, _ = setup_of([group.world], **functions, policy_ticks=job.policy_ticks)
    return replace(setup, structure=structure, varied=which), [jnp.asarray(leaf) for leaf in fixed], own
