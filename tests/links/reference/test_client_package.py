"""The client in Python as a package of its own: with this interpreter and protobuf, and with old and new ones."""

from __future__ import annotations

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from wires import TASK, Running, running

import qrsim

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = ROOT / "clients" / "python"
SEED = 33
# The oldest and newest Python and protobuf that it is for, and those between that differ in how messages are made.
OLD_PYTHON = "3.8"
COMBINATIONS = [
    (OLD_PYTHON, "3.20.*"),
    (OLD_PYTHON, "5.29.*"),
    (None, "3.20.*"),
    (None, "4.25.*"),
    (None, "6.*"),
    (None, ""),
]


@pytest.fixture
def served() -> Any:
    """A server that cannot be ended by its clients."""
    with running(seed=SEED) as found:
        yield found


def toured(python: str, served: Running, **variables: str) -> dict[str, Any]:
    """Return what the tour brought in a process of its own, after what it must bring was checked."""
    words = [python, str(Path(__file__).parent / "client_tour.py"), str(served.port)]
    done = subprocess.run(
        words, env={**os.environ, **variables}, capture_output=True, text=True, check=False, timeout=300
    )
    assert (done.stderr, done.returncode) == ("", 0)
    found: dict[str, Any] = json.loads(done.stdout)
    here = qrsim.load(TASK, seed=SEED)
    here.reset()
    assert found["init"] == [1, 0.02, 0.0, [1, 13], [1, 20]]
    here.step(here.waypoint([6.0, -8.0, -9.0]), ticks=50)
    assert found["waypoint"] == here.truth.state[0].tolist()
    here.reset(SEED + 1)
    here.set_state([[5.0, -6.0, -8.0, 0.0, 0.1, 0.2]])
    here.step(here.waypoint([5.0, -6.0, -8.0], 0.2))
    assert found["set_state"] == here.truth.state[0].tolist()
    assert found["invalid"] == ["InvalidState", f"127.0.0.1:{served.port}: invalid uav state"]
    assert found["refused"][0] == "Refused"
    assert "dt: 0.03 s is not a positive multiple of the time step, 0.02 s" in found["refused"][1]
    assert found["usage"][0] == "UsageError"
    assert (found["claim"][0], found["order"][0]) == ("Refused", "UsageError")
    assert found["claim"][1].endswith("(--pace barrier or free)")
    assert found["describe"] == ["box", "accelerometer"]
    assert found["open"] == ["free_flight", 5, ["pelicans_0"], True]
    assert found["restart"] == [6, 9]
    assert found["readings"] == [["accelerometer", "attitude", "barometer", "gnss", "gyroscope"], [4], ""]
    assert (found["events"], found["pace"], found["watched"]) == (["out_of_area"], 0.0, [1, 13])
    assert found["play"][:4] == [["pelicans_0"], 7, found["play"][2], 1]
    assert "--allow-quit" in found["quit"]
    assert "nobody listens there" in found["nobody"]
    return found


def test_what_it_shares_with_qrsim_is_the_same():
    """To write it anew: python clients/python/generate.py."""
    for path, text in runpy.run_path(str(PACKAGE / "generate.py"))["generated"]().items():
        assert path.read_text("utf-8") == text, path


def test_every_call_with_this_interpreter(served):
    toured(sys.executable, served, PYTHONPATH=str(PACKAGE))


def test_it_can_be_imported_beside_qrsim():
    words = (
        "import qrsim.links.reference.client, qrsim_client, qrsim_client.qrsim_pb2 as b; "
        "import qrsim.links.reference.protocol.qrsim_pb2 as a; "
        "a.Message(type=1); assert a.Message is not b.Message; assert b.Message(type=1).type == 1"
    )
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join([str(PACKAGE), os.environ.get("PYTHONPATH", "")])}
    subprocess.run([sys.executable, "-c", words], check=True, env=variables)


def interpreter(version: str | None) -> str:
    """Return a Python of a version; skips where there is none."""
    if version is None:
        return sys.executable
    for folder in sorted((Path.home() / ".pyenv" / "versions").glob(f"{version}.*")):
        if (folder / "bin" / "python").exists():
            return str(folder / "bin" / "python")
    return pytest.skip(f"there is no Python {version} in ~/.pyenv/versions: pyenv install {version}")


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("version", "protobuf"),
    # The oldest of both and the newest of both are enough to see a call that one of them does not have.
    [pytest.param(*each, marks=() if each in COMBINATIONS[::5] else pytest.mark.nightly) for each in COMBINATIONS],
)
def test_every_call_as_it_is_installed_with_old_and_new_protobuf(version, protobuf, served, tmp_path):
    python = tmp_path / "venv" / "bin" / "python"
    subprocess.run([interpreter(version), "-m", "venv", str(tmp_path / "venv")], check=True)
    wanted = f"protobuf=={protobuf}" if protobuf else "protobuf"
    install = [str(python), "-m", "pip", "install", "-q", "--disable-pip-version-check", str(PACKAGE), wanted]
    pinned = ("PIP_CONSTRAINT", "PIP_BUILD_CONSTRAINT", "PYTHONPATH")
    plain = {name: value for name, value in os.environ.items() if name not in pinned}
    done = subprocess.run(install, env=plain, capture_output=True, text=True, check=False)
    if done.returncode and "connection" in done.stderr.lower():
        pytest.skip(f"no package index can be reached: {done.stderr.splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    found = toured(str(python), served, PYTHONPATH="")
    if version is not None:
        assert found["python"] == [3, 8]
    assert found["protobuf"].startswith(protobuf.rstrip("*"))
    if protobuf == "3.20.*":
        with running(seed=SEED) as another:
            toured(str(python), another, PYTHONPATH="", PROTOCOL_BUFFERS_PYTHON_IMPLEMENTATION="python")
