"""Flies the missing batches of a study on the available workers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import RunError
from qrsim.studies.sweep.flying import dumped, fly
from qrsim.studies.sweep.job import Job
from qrsim.studies.sweep.plan import Batch, Plan
from qrsim.studies.sweep.store import Store

# Batches for each worker that are handed out ahead, so that none waits.
AHEAD = 2


def sweep(plan: Plan, store: Store, client: Any, progress: Callable[[Batch], None] = lambda batch: None) -> None:
    """Fly the batches of a study that are not stored, on Dask workers, and store each as soon as it is done.

    Args:
        plan: of the study.
        store: of its results.
        client: of Dask, with workers.
        progress: called after each batch.

    Raises:
        RunError: a batch cannot be flown or written, or the workers are gone; what was kept before stays.
    """
    from distributed import as_completed

    missing = iter(np.flatnonzero(~store.done).tolist())
    jobs = Jobs(plan, store.metrics)
    waiting: dict[str, Batch] = {}
    finished = as_completed(loop=client.loop)

    def hand_out() -> None:
        """Submit batches until AHEAD of them per worker thread are waiting or flying."""
        while len(waiting) < AHEAD * max(1, _threads(client)):
            index = next(missing, None)
            if index is None:
                return
            batch = plan.batch(index)
            # Nothing is taken from what the workers may remember of an earlier sweep.
            future = client.submit(fly, jobs.job(batch), pure=False, key=f"qrsim-{store.path.name}-{index}-{id(jobs)}")
            waiting[future.key] = batch
            finished.add(future)

    hand_out()
    for future in finished:
        batch = waiting.pop(future.key)
        store.write(batch, _result(future, batch, store))
        future.release()
        progress(batch)
        hand_out()
    if not store.done.all():
        raise RunError(f"{store.path}: {int((~store.done).sum())} batches are missing; the same command goes on")


def _threads(client: Any) -> int:
    """Return the number of threads that all Dask workers have at present."""
    return sum(client.nthreads().values()) if client.status == "running" else 0


class Jobs:
    """Turns batches into jobs."""

    def __init__(self, plan: Plan, metrics: tuple[str, ...]):
        self._spec, self._code = plan.study.spec, tuple(plan.study.code.items())
        self._groups = {key: dumped(group) for key, group in plan.groups.items()}
        self._metrics = metrics

    def job(self, batch: Batch) -> Job:
        """Return the job, with all data of a batch, that a worker flies."""
        spec = self._spec
        return Job(
            self._groups[batch.group],
            batch.numbers,
            batch.seeds,
            self._metrics,
            spec.policy,
            spec.estimator,
            spec.policy_ticks,
            self._code,
            spec.precision,
            spec.own_metrics,
            spec.track,
        )


def _result(future: Any, batch: Batch, store: Store) -> dict[str, NumpyArray]:
    """Return the results of a batch from its Dask future; raises RunError if it could not be flown.

    Raises:
        RunError: it could not be flown.
    """
    try:
        found = future.result()
    except Exception as error:
        raise RunError(
            f"batch {batch.index + 1}: a worker failed: {type(error).__name__}: {str(error).partition(chr(10))[0]}; "
            f"{_kept(store)}"
        ) from error
    return _checked(found, batch, store)


def _checked(found: dict[str, NumpyArray] | str, batch: Batch, store: Store) -> dict[str, NumpyArray]:
    """Return the results of a batch; raises RunError if the worker returned an error text instead."""
    if isinstance(found, str):
        raise RunError(f"batch {batch.index + 1}: {found}; {_kept(store)}")
    return found


def _kept(store: Store) -> str:
    """Return as text how many batches are stored, for error messages."""
    return f"the {int(store.done.sum())} batches written before are kept, and the same command goes on from there"


def sweep_here(plan: Plan, store: Store, progress: Callable[[Batch], None] = lambda batch: None) -> None:
    """Fly the batches of a study that are not stored, in this process, and store each as soon as it is done.

    Args:
        plan: of the study.
        store: of its results.
        progress: called after each batch.

    Raises:
        RunError: a batch cannot be flown or written.
    """
    jobs = Jobs(plan, store.metrics)
    for index in np.flatnonzero(~store.done).tolist():
        batch = plan.batch(index)
        store.write(batch, _checked(fly(jobs.job(batch)), batch, store))
        progress(batch)
