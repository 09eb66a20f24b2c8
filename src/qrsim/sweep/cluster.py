"""Dask workers: of a temporary cluster on this machine's cores, or of any Dask scheduler."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from qrsim.errors import RunError
from qrsim.interruptions import calling
from qrsim.sweep.provenance import differences, network_versions

WAIT_S = 10.0


@contextmanager
def workers_of(scheduler: str | None, workers: int) -> Iterator[Any]:
    """Yield a Dask client whose workers have this process's versions.

    Args:
        scheduler: address of a scheduler; None: a cluster of processes of this machine.
        workers: processes of the latter, each with one thread.

    Raises:
        RunError: the scheduler cannot be reached, has no workers, or they have other versions.
    """
    import dask
    import distributed

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    quiet = {"distributed.logging.distributed": "critical", "distributed.comm.timeouts.connect": f"{WAIT_S}s"}
    with dask.config.set(quiet):
        if scheduler is None:
            with ExitStack() as open_ones:
                # A cluster that is interrupted while it starts leaves processes behind.
                with calling(lambda: None):
                    cluster = open_ones.enter_context(
                        distributed.LocalCluster(  # type: ignore[no-untyped-call]
                            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0",
                            silence_logs=logging.CRITICAL,
                        )
                    )  # fmt: skip
                    client = open_ones.enter_context(distributed.Client(cluster))  # type: ignore[no-untyped-call]
                yield client
            return
        try:
            client = distributed.Client(  # type: ignore[no-untyped-call]
                scheduler, timeout=WAIT_S, set_as_default=False
            )
        except (OSError, ValueError, TypeError) as error:
            raise RunError(
                f"--scheduler {scheduler}: no scheduler answers there ({_reason(error)}); 'dask scheduler' starts one "
                "and prints its address, for example tcp://192.168.0.1:8786"
            ) from None
        with client:
            check_workers(client, scheduler)
            yield client


def _reason(error: Exception) -> str:
    return str(error).partition("\n")[0] or type(error).__name__


def check_workers(client: Any, address: str) -> None:
    """Refuse a scheduler whose workers have other versions and could give other numbers.

    Raises:
        RunError: there is no worker, or one has no qrsim or other versions; the message says which.
    """
    try:
        client.wait_for_workers(1, timeout=WAIT_S)
    except TimeoutError:
        raise RunError(
            f"--scheduler {address}: it has no workers; start some with 'dask worker {address} --nthreads 1'"
        ) from None
    mine = network_versions()
    try:
        theirs = client.run(network_versions, on_error="return")
    except Exception as error:
        raise RunError(
            f"--scheduler {address}: its workers cannot say their versions: {type(error).__name__}: {_reason(error)}"
        ) from error
    wrong = []
    for worker, found in theirs.items():
        if isinstance(found, BaseException):
            wrong.append(f"{worker}: it cannot say its versions: {type(found).__name__}: {found}")
        elif found != mine:
            wrong.append(f"{worker}: {'; '.join(differences(mine, found))}")
    if wrong:
        lines = "".join(f"\n  {line}" for line in wrong)
        raise RunError(f"--scheduler {address}: {len(wrong)} of {len(theirs)} workers have other versions{lines}")
