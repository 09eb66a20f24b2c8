"""Dask workers: of a temporary cluster on this machine's cores, or of any Dask scheduler."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from qrsim.errors import RunError, UsageError, did_you_mean_file
from qrsim.files.interruptions import calling
from qrsim.studies.sweep.provenance import differences, network_versions

if TYPE_CHECKING:
    from distributed import Client

WAIT_S = 10.0


@dataclass(frozen=True)
class Tls:
    """Files that prove who talks to a scheduler: its authority, and certificate and key of this client."""

    ca: Path
    cert: Path
    key: Path

    def security(self) -> object:
        """Return the TLS settings as a Dask ``Security`` object.

        Raises:
            UsageError: a file cannot be read.
        """
        from distributed.security import Security

        for option, file in (("--tls-ca", self.ca), ("--tls-cert", self.cert), ("--tls-key", self.key)):
            if not file.is_file():
                raise UsageError(f"{option} {file}: no such file{did_you_mean_file(file)}")
        return Security(
            tls_ca_file=str(self.ca),
            tls_client_cert=str(self.cert),
            tls_client_key=str(self.key),
            require_encryption=True,
        )


@contextmanager
def workers_of(scheduler: str | None, workers: int, tls: Tls | None = None) -> Iterator[object]:
    """Yield a Dask client for a scheduler's workers, or for new local ones, with the versions of this process.

    The cluster of this machine takes nobody who has not the key that is made for it, because whoever talks to a
    scheduler can run code as its user.

    Args:
        scheduler: address of a scheduler; None: a cluster of processes of this machine.
        workers: processes of the latter, each with one thread.
        tls: for a scheduler that asks for certificates.

    Raises:
        UsageError: a file of ``tls`` cannot be read.
        RunError: the scheduler cannot be reached, has no workers, or they have other versions.
    """
    import dask
    import distributed
    from distributed.security import Security

    security = None if tls is None else tls.security()
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    quiet: dict[str, object] = {
        "distributed.logging.distributed": "critical",
        "distributed.comm.timeouts.connect": f"{WAIT_S}s",
    }
    if scheduler is None:
        # Pages by HTTP ask nobody who they are.
        quiet |= {"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}
    with dask.config.set(quiet):
        if scheduler is None:
            with ExitStack() as open_ones:
                # A cluster that is interrupted while it starts leaves processes behind.
                with calling(lambda: None):
                    cluster = open_ones.enter_context(
                        distributed.LocalCluster(
                            n_workers=workers,
                            threads_per_worker=1,
                            processes=True,
                            dashboard_address="127.0.0.1:0",
                            scheduler_kwargs={"dashboard": False},
                            silence_logs=logging.CRITICAL,
                            security=Security.temporary(),
                        )
                    )
                    client = open_ones.enter_context(distributed.Client(cluster))
                yield client
            return
        try:
            client = distributed.Client(scheduler, timeout=WAIT_S, set_as_default=False, security=security)
        except (OSError, ValueError, TypeError) as error:
            raise RunError(
                f"--scheduler {scheduler}: no scheduler answers there ({_reason(error)}); 'dask scheduler' starts one "
                "and prints its address, for example tcp://192.168.0.1:8786"
            ) from None
        with client:
            check_workers(client, scheduler)
            yield client


def _reason(error: Exception) -> str:
    """Return the first line of an error's text, or its type if it has no text."""
    return str(error).partition("\n")[0] or type(error).__name__


def check_workers(client: Client, address: str) -> None:
    """Raise an error if a Dask worker runs other versions than this process, which could give other numbers.

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
            f"--scheduler {address}: its workers do not report their versions: {type(error).__name__}: {_reason(error)}"
        ) from error
    wrong = []
    for worker, found in theirs.items():
        if isinstance(found, BaseException):
            wrong.append(f"{worker}: it does not report its versions: {type(found).__name__}: {found}")
        elif found != mine:
            wrong.append(f"{worker}: {'; '.join(differences(mine, found))}")
    if wrong:
        raise RunError(
            f"--scheduler {address}: {len(wrong)} of {len(theirs)} workers have other versions",
            *(f"  {line}" for line in wrong),
        )
