"""Clients in C++, built with the system's protoc: the one of the tests, and the one that docs/serve.md shows."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from wires import TASK, Running, running

import qrsim

ROOT = Path(__file__).resolve().parents[3]
INSTALL_LINE = "apt-get install protobuf-compiler libprotobuf-dev g++ pkg-config"
SEED = 21


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """Return a function that builds a program from its name and text; skips where the tools are missing."""
    missing = [tool for tool in ("protoc", "g++", "pkg-config") if shutil.which(tool) is None]
    if not missing and subprocess.run(["pkg-config", "--exists", "protobuf"], check=False).returncode:
        missing = ["libprotobuf-dev"]
    if missing:
        pytest.skip(f"no C++ client can be built, for want of {', '.join(missing)}: {INSTALL_LINE}")
    folder = tmp_path_factory.mktemp("cpp")
    proto = "qrsim/protocol/qrsim.proto"
    subprocess.run(["protoc", f"--proto_path={ROOT / 'src'}", f"--cpp_out={folder}", proto], check=True)
    found = subprocess.run(["pkg-config", "--cflags", "--libs", "protobuf"], capture_output=True, text=True, check=True)
    flags = found.stdout.split()
    generated = folder / "qrsim/protocol/qrsim.pb.o"
    command = ["g++", "-std=c++17", f"-I{folder}", "-c", str(generated.with_suffix(".cc")), "-o", str(generated)]
    subprocess.run(command, check=True)

    def built(name: str, text: str) -> Path:
        source, program = folder / f"{name}.cc", folder / name
        source.write_text(text, "utf-8")
        options = ["-std=c++17", "-Wall", "-Werror", f"-I{folder}"]
        subprocess.run(["g++", *options, str(source), str(generated), *flags, "-o", str(program)], check=True)
        return program

    return built


@pytest.fixture
def served() -> Iterator[Running]:
    """A server that clients may end."""
    with running(allow_quit=True, seed=SEED) as found:
        yield found


def test_a_client_in_cpp_runs_the_whole_reference_protocol(build, served):
    program = build("reference_client", (Path(__file__).parent / "reference_client.cc").read_text("utf-8"))
    done = subprocess.run(
        [program, str(served.port), "TaskComplacs"], capture_output=True, text=True, check=False, timeout=120
    )
    assert (done.stderr, done.returncode) == ("", 0)
    said = done.stdout.splitlines()
    here = qrsim.load(TASK, seed=SEED)
    here.reset()
    expected = [state_line("init", here), "init TASKINFO 0.02 1"]
    for what, command, ticks in (
        ("wp", here.waypoint([7.0, -8.0, -9.5], 0.3), 10),
        ("ctrl", [[0.01, -0.02, 0.6, 0.1, 11.8]], 1),
        ("vel", qrsim.VelocitySetpoint.of([[0.5, 0.0, -0.2]], 0.0), 50),
    ):
        here.step(command, ticks=ticks)
        expected.append(state_line(what, here))
    expected.append("wrong ACK error 1 dt: 0.03 s is not a positive multiple of the time step, 0.02 s")
    here.reset(SEED + 1)
    here.set_state([[5.0, -6.0, -8.0, 0.0, 0.1, 0.2]])
    here.step(here.waypoint([5.0, -6.0, -8.0], 0.2))
    expected += ["reset ACK error 0 ", "setstate ACK error 0 ", state_line("wp", here), "disconnect ACK error 0 "]
    here.reset(SEED + 2)
    expected += [state_line("init", here), "init TASKINFO 0.02 1", "disconnect ACK error 0 ", "quit ACK error 0 "]
    assert said == expected
    served.thread.join(30.0)
    assert not served.thread.is_alive(), "it was allowed to quit"


def state_line(what: str, simulation: qrsim.Simulation) -> str:
    numbers = " ".join(f"{value:.17g}" for value in np.asarray(simulation.truth.state[0], np.float64))
    return f"{what} STATE t {simulation.time:.17g} vehicles 1/1 of 13/20 {numbers}"


def test_the_program_of_the_documentation_flies(build, served):
    page = (ROOT / "docs" / "serve.md").read_text("utf-8")
    [text] = re.findall(r"^```cpp\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    done = subprocess.run(
        [build("fly", text), str(served.port)], capture_output=True, text=True, check=False, timeout=120
    )
    assert (done.stderr, done.returncode) == ("", 0)
    assert done.stdout.splitlines()[-1].startswith("t = 10 s: ")
