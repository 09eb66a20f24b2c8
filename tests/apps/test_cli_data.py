"""``qrsim data`` against a server on this machine that holds small files, and the checks of the recordings."""

from __future__ import annotations

import hashlib
import json
import os
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from qrsim import cli
from qrsim.apps import data as command
from qrsim.errors import RunError, UsageError
from qrsim.files import recordings
from qrsim.files.recordings import Recording

CONTENTS = {"rig.csv": b"1,2,3\n" * 1000, "flight.csv": b"4,5,6\n", "orbits.sp3": b"#a2010\n"}


class Server(ThreadingHTTPServer):
    """Serves ``files`` (path to bytes) and keeps a list of what was asked for."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.asked: list[str] = []
        super().__init__(("127.0.0.1", 0), Handler)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/"


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        self.server.asked.append(self.path)
        content = self.server.files.get(self.path)
        self.send_response(404 if content is None else 200)
        self.send_header("Content-Length", str(len(content or b"")))
        self.end_headers()
        self.wfile.write(content or b"")

    def log_message(self, *arguments: object) -> None:
        pass


@pytest.fixture
def upstream(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Server]:
    """A server with three files, which stand in the registry; no folder is set and the cache is a fresh one."""
    server = Server()
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    registry = {
        name: Recording(f"deep/{name}.upstream", hashlib.sha256(content).hexdigest())
        for name, content in CONTENTS.items()
    }
    server.files = {f"/deep/{name}.upstream": content for name, content in CONTENTS.items()}
    monkeypatch.setattr(recordings, "RECORDINGS", registry)
    monkeypatch.setattr(recordings, "UPSTREAM", server.url)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.delenv("QRSIM_DATA_DIR", raising=False)
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda name, **_: str(tmp_path / "cache" / name))
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_fetch_into_a_folder(upstream, tmp_path, capsys):
    folder = tmp_path / "new" / "my data"
    assert cli.main(["data", "fetch", "--dest", str(folder)]) == 0
    assert contents(folder) == CONTENTS
    printed = capsys.readouterr()
    assert printed.out.splitlines()[-2:] == [f"folder: {folder}", f"export QRSIM_DATA_DIR='{folder}'"]
    assert printed.err == ""


def test_fetch_without_a_folder_uses_the_variable_then_the_cache(upstream, tmp_path, monkeypatch):
    assert cli.main(["data", "fetch"]) == 0
    assert contents(tmp_path / "cache" / "qrsim" / "recordings") == CONTENTS
    monkeypatch.setenv("QRSIM_DATA_DIR", str(tmp_path / "chosen"))
    assert cli.main(["data", "fetch"]) == 0
    assert contents(tmp_path / "chosen") == CONTENTS
    monkeypatch.setenv("QRSIM_DATA_DIR", "")
    assert recordings.data_folder() == tmp_path / "cache" / "qrsim" / "recordings"


def test_good_files_are_kept_and_altered_ones_fetched_again(upstream, tmp_path, capsys):
    (tmp_path / "rig.csv").write_bytes(CONTENTS["rig.csv"])
    (tmp_path / "flight.csv").write_bytes(b"4,5,7\n")
    assert cli.main(["data", "fetch", "--dest", str(tmp_path)]) == 0
    assert upstream.asked == ["/deep/flight.csv.upstream", "/deep/orbits.sp3.upstream"]
    assert {name: (tmp_path / name).read_bytes() for name in CONTENTS} == CONTENTS
    lines = capsys.readouterr().out.splitlines()
    expected, found = (hashlib.sha256(text).hexdigest() for text in (b"4,5,6\n", b"4,5,7\n"))
    assert lines[:4] == [
        "kept     rig.csv",
        f"altered  flight.csv: expected sha256 {expected}, found {found}; fetching it again",
        "fetched  flight.csv",
        "fetched  orbits.sp3",
    ]


def refused(code: int, capsys: pytest.CaptureFixture[str], *parts: str) -> None:
    printed = capsys.readouterr().err
    assert code == 1
    assert printed.startswith("error: ")
    assert "Traceback" not in printed
    for part in parts:
        assert part in printed


def test_no_network(upstream, tmp_path, monkeypatch, capsys):
    """Nothing listens on port 1; the files that are still missing are named, with their addresses."""
    (tmp_path / "rig.csv").write_bytes(CONTENTS["rig.csv"])
    monkeypatch.setattr(recordings, "UPSTREAM", "http://127.0.0.1:1/")
    code = cli.main(["data", "fetch", "--dest", str(tmp_path)])
    refused(
        code,
        capsys,
        "cannot fetch flight.csv from http://127.0.0.1:1/deep/flight.csv.upstream: no answer (ConnectionError)",
        f"http://127.0.0.1:1/deep/flight.csv.upstream\n    as {tmp_path / 'flight.csv'}",
        f"http://127.0.0.1:1/deep/orbits.sp3.upstream\n    as {tmp_path / 'orbits.sp3'}",
        f"QRSIM_DATA_DIR={tmp_path} qrsim data where",
    )
    assert contents(tmp_path) == {"rig.csv": CONTENTS["rig.csv"]}


def test_file_that_the_server_lacks(upstream, tmp_path, capsys):
    del upstream.files["/deep/flight.csv.upstream"]
    refused(cli.main(["data", "fetch", "--dest", str(tmp_path)]), capsys, "404", "deep/flight.csv.upstream")
    assert contents(tmp_path) == {"rig.csv": CONTENTS["rig.csv"]}


def test_wrong_bytes_are_not_kept(upstream, tmp_path, capsys):
    upstream.files["/deep/rig.csv.upstream"] = b"something else"
    wrong = hashlib.sha256(b"something else").hexdigest()
    refused(cli.main(["data", "fetch", "--dest", str(tmp_path)]), capsys, "cannot fetch rig.csv", wrong)
    assert contents(tmp_path) == {}


def test_folder_that_cannot_be(upstream, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    refused(cli.main(["data", "fetch", "--dest", str(tmp_path / "file")]), capsys, "file is not a folder")
    refused(cli.main(["data", "fetch", "--dest", str(tmp_path / "file" / "sub")]), capsys, "cannot make the folder")


def test_where(upstream, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("QRSIM_DATA_DIR", str(tmp_path))
    (tmp_path / "rig.csv").write_bytes(CONTENTS["rig.csv"])
    (tmp_path / "flight.csv").write_bytes(b"?")
    assert cli.main(["data", "where"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"folder: {tmp_path}",
        "  good     rig.csv",
        "  altered  flight.csv",
        "  missing  orbits.sp3",
        "'qrsim data fetch' downloads missing and altered files",
    ]
    assert cli.main(["data", "where", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["folder"], answer["complete"]) == (str(tmp_path), False)
    assert {row["name"]: row["condition"] for row in answer["files"]} == {
        "rig.csv": "good",
        "flight.csv": "altered",
        "orbits.sp3": "missing",
    }
    assert answer["files"][1]["sha256_found"] == hashlib.sha256(b"?").hexdigest()


def test_progress_bar_shows_the_bytes(upstream, tmp_path):
    """The bar takes pooch's calls and ends at the file's size."""
    from rich.progress import Progress

    progress = Progress(disable=True)
    recordings.fetch_file("rig.csv", tmp_path, command._RichBar(progress, "rig.csv"))
    task = progress.tasks[0]
    assert (task.completed, task.total) == (6000, 6000)


def test_data_file(upstream, tmp_path, monkeypatch):
    monkeypatch.setenv("QRSIM_DATA_DIR", str(tmp_path))
    with pytest.raises(RunError, match=r"rig\.csv is not in .*; 'qrsim data fetch' gets it"):
        recordings.data_file("rig.csv")
    (tmp_path / "rig.csv").write_bytes(b"?")
    expected, found = (hashlib.sha256(text).hexdigest() for text in (CONTENTS["rig.csv"], b"?"))
    with pytest.raises(RunError, match=f"expected sha256 {expected}, found {found}; 'qrsim data fetch' replaces it"):
        recordings.data_file("rig.csv")
    (tmp_path / "rig.csv").write_bytes(CONTENTS["rig.csv"])
    assert recordings.data_file("rig.csv") == tmp_path / "rig.csv"
    with pytest.raises(UsageError, match=r"no recording is called 'rigg\.csv'; did you mean 'rig\.csv'\?"):
        recordings.data_file("rigg.csv")
    (tmp_path / "orbits.sp3").mkdir()
    with pytest.raises(RunError, match="cannot read"):
        recordings.data_file("orbits.sp3")


def test_the_registry_matches_the_recordings(recordings: Path):
    from qrsim.files.recordings import RECORDINGS, data_file

    assert os.environ["QRSIM_DATA_DIR"] == str(recordings)
    for name in RECORDINGS:
        assert data_file(name).parent == recordings.absolute()
