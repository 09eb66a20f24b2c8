"""Sweeps on processes: killed ones, separate clusters, and clusters that cannot be used."""

from __future__ import annotations

import asyncio
import socket
import ssl
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import distributed
import pytest
from distributed.comm import connect
from tests.studies.sweep.conftest import flown, write
from tests.studies.sweep.killing import dask, kill_process, kill_worker, opened, same
from tests.studies.sweep.killing import scheduler as running

from qrsim.cli import main
from qrsim.errors import RunError
from qrsim.studies.sweep import cluster
from qrsim.studies.sweep.cluster import workers_of

pytestmark = pytest.mark.long

# Many small batches, so that there is a middle to be killed in.
MANY = {"seeds": 20, "batch": 4}
BATCHES = 60


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The Dataset of the study, flown in this process."""
    return opened(flown(tmp_path_factory.mktemp("whole"), **MANY))


@pytest.mark.nightly
def test_a_process_that_is_killed_goes_on_where_it_was(tmp_path: Path, whole: Any) -> None:
    store = tmp_path / "killed.zarr"
    assert 5 <= kill_process(store, [str(write(tmp_path, **MANY))], 5) < BATCHES
    assert same(opened(store), whole)


def test_a_worker_that_is_killed_is_replaced(tmp_path: Path, whole: Any) -> None:
    store = tmp_path / "store.zarr"
    assert 5 <= kill_worker(store, [str(write(tmp_path, **MANY))], 5) < BATCHES
    assert same(opened(store), whole)


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a scheduler in a process of its own, without workers."""
    with running(tmp_path_factory.mktemp("scheduler")) as address:
        yield address


def test_a_cluster_of_separate_processes_gives_the_same(tmp_path: Path, whole: Any, scheduler: str) -> None:
    store = tmp_path / "store.zarr"
    words = ["sweep", str(write(tmp_path, **MANY)), "--scheduler", scheduler, "--out", str(store)]
    with dask("worker", scheduler, "--nthreads", "1", "--local-directory", str(tmp_path)):
        assert main(words) == 0
    assert same(opened(store), whole)


OLD = """
from importlib import metadata


def version(name, true=metadata.version):
    return "0.0.1" if name == "jaxlib" else true(name)


metadata.version = version
"""


def test_a_worker_of_another_version_is_refused(tmp_path: Path, scheduler: str, capsys: Any) -> None:
    (tmp_path / "old.py").write_text(OLD)
    store = tmp_path / "store.zarr"
    words = ["sweep", str(write(tmp_path)), "--scheduler", scheduler, "--out", str(store)]
    preload = ["--local-directory", str(tmp_path), "--preload", str(tmp_path / "old.py")]
    with dask("worker", scheduler, "--nthreads", "1", *preload):
        assert main(words) == 1
    said = capsys.readouterr().err
    assert "1 of 1 workers have other versions" in said
    assert "jaxlib: " in said
    assert "0.0.1 there" in said
    assert not opened(store)["flown"].any()


def test_a_scheduler_that_cannot_be_used_is_named(
    tmp_path: Path, scheduler: str, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.setattr(cluster, "WAIT_S", 1.0)
    study = str(write(tmp_path))
    for address, said in [
        ("tcp://127.0.0.1:1", "no scheduler answers there"),
        ("nonsense://x", "no scheduler answers there"),
        (scheduler, "it has no workers"),
    ]:
        assert main(["sweep", study, "--scheduler", address, "--out", str(tmp_path / "s.zarr")]) == 1
        told = capsys.readouterr().err
        assert f"--scheduler {address}: {said}" in told


def test_versions_that_differ_are_listed() -> None:
    class Client:
        def wait_for_workers(self, count: int, timeout: float) -> None: ...

        def run(self, function: Any, on_error: str) -> dict[str, Any]:
            mine = function()
            return {"a": mine, "b": {**mine, "numpy": "1.0"}, "c": ModuleNotFoundError("No module named 'qrsim'")}

    with pytest.raises(RunError) as caught:
        cluster.check_workers(Client(), "tcp://here:1")
    said = str(caught.value)
    assert "2 of 3 workers" in said
    assert "b: numpy: " in said
    assert "1.0 there" in said
    assert "c: it does not report its versions: ModuleNotFoundError: No module named 'qrsim'" in said


@pytest.mark.long
def test_a_stranger_is_refused_by_the_workers_of_this_machine(capsys: Any) -> None:
    """Whoever talks to a scheduler can run code there: nobody may without the key, and no port takes plain text."""
    with workers_of(None, 1) as client:
        address = client.scheduler.address
        assert address.startswith("tls://")
        assert client.submit(sum, [1, 2]).result(timeout=30) == 3
        own = distributed.Security.temporary().get_connection_args("client")
        for stranger, words in ((address, {}), (address.replace("tls://", "tcp://"), {}), (address, own)):
            with pytest.raises((OSError, ValueError, TypeError, RuntimeError)):
                asyncio.run(connect(stranger, timeout=3, **words))
        # Pages by HTTP ask nobody who they are, so there are none.
        port = client.scheduler_info()["services"].get("dashboard")
        for page in ("status", "api/v1/get_workers", "info/main/workers.html"):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                urllib.request.urlopen(f"http://127.0.0.1:{port}/{page}", timeout=5)
    assert "Traceback" not in capsys.readouterr().err


def test_certificates_come_together_and_are_there(tmp_path: Path, capsys: Any) -> None:
    study = str(write(tmp_path))
    for words, told in (
        (["--scheduler", "tls://here:1", "--tls-ca", "ca.pem"], "--tls-cert: missing; TLS needs --tls-ca, --tls-cert"),
        (["--tls-ca", "a", "--tls-cert", "b", "--tls-key", "c"], "--tls-ca: without --scheduler"),
        (
            ["--scheduler", "tls://here:1", "--tls-ca", "a.pem", "--tls-cert", "b", "--tls-key", "c"],
            "--tls-ca a.pem: no such file",
        ),
    ):
        assert main(["sweep", study, *words, "--out", str(tmp_path / "s.zarr")]) == 2
        assert told in capsys.readouterr().err


def test_tls_without_the_certificate_gets_no_byte() -> None:
    """Dask's client refuses before it connects where it has no certificate; a stranger need not use Dask's client."""

    def received(context: ssl.SSLContext, port: int) -> bytes:
        with socket.create_connection(("127.0.0.1", port), timeout=5) as plain, context.wrap_socket(plain) as secret:
            return secret.recv(1)

    bare = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    bare.check_hostname, bare.verify_mode = False, ssl.CERT_NONE
    with workers_of(None, 1) as client:
        own = client.security.get_connection_args("client")["ssl_context"]
        workers = client.scheduler_info()["workers"]
        addresses = [client.scheduler.address, *workers, *(each["nanny"] for each in workers.values())]
        assert len(addresses) == 3
        for address in addresses:
            port = int(address.rpartition(":")[2])
            assert len(received(own, port)) == 1
            with pytest.raises(ssl.SSLError, match="CERTIFICATE_REQUIRED"):
                received(bare, port)
