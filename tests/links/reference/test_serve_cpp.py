"""Clients in C++, built with the system's protoc: one as those of the reference, and clients/cpp with its examples."""

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
from qrsim.links.reference.client import Client
from qrsim.links.reference.tasks import Tasks
from qrsim.simulation.simulation import Simulation
from small_worlds import pair

ROOT = Path(__file__).resolve().parents[3]
HEADER = ROOT / "clients" / "cpp"
INSTALL_LINE = "apt-get install protobuf-compiler libprotobuf-dev g++ pkg-config"
SEED = 21
# The compiler of C++ takes long.
pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """Return a function that builds a program from its name and text; skips where the tools are missing."""
    missing = [tool for tool in ("protoc", "g++", "pkg-config") if shutil.which(tool) is None]
    if not missing and subprocess.run(["pkg-config", "--exists", "protobuf"], check=False).returncode:
        missing = ["libprotobuf-dev"]
    if missing:
        pytest.skip(f"no C++ client can be built, for want of {', '.join(missing)}: {INSTALL_LINE}")
    folder = tmp_path_factory.mktemp("cpp")
    subprocess.run(["protoc", f"--proto_path={HEADER}", f"--cpp_out={folder}", "qrsim.proto"], check=True)
    found = subprocess.run(["pkg-config", "--cflags", "--libs", "protobuf"], capture_output=True, text=True, check=True)
    flags = found.stdout.split()
    generated = folder / "qrsim.pb.o"
    command = ["g++", "-std=c++17", f"-I{folder}", "-c", str(generated.with_suffix(".cc")), "-o", str(generated)]
    subprocess.run(command, check=True)

    def built(name: str, text: str) -> Path:
        source, program = folder / f"{name}.cc", folder / name
        source.write_text(text, "utf-8")
        options = ["-std=c++17", "-Wall", "-Wextra", "-Werror", f"-I{folder}", f"-I{HEADER}"]
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


def test_the_header_has_every_call(build, served):
    program = build("client_tour", (Path(__file__).parent / "client_tour.cpp").read_text("utf-8"))
    done = subprocess.run([program, str(served.port)], capture_output=True, text=True, check=False, timeout=120)
    assert (done.stderr, done.returncode) == ("", 0)
    here, where = qrsim.load(TASK, seed=SEED), f"127.0.0.1:{served.port}"
    here.reset()
    expected = [tour_line("init", here), "info 1 0.02"]
    for what, command, ticks in (
        ("waypoint", here.waypoint([6.0, -8.0, -9.0]), 50),
        ("velocity", qrsim.VelocitySetpoint.of([[0.5, 0.0, 0.0]], 0.0), 5),
        ("control", [[0.0, 0.0, 0.59, 0.0, 12.0]], 1),
    ):
        here.step(command, ticks=ticks)
        expected.append(tour_line(what, here))
    here.reset(SEED + 1)
    here.set_state([[5.0, -6.0, -8.0, 0.0, 0.1, 0.2]])
    here.step(here.waypoint([5.0, -6.0, -8.0], 0.2))
    expected.append(tour_line("set_state", here))
    expected.append(f"refused: {where}: dt: 0.03 s is not a positive multiple of the time step, 0.02 s")
    expected += [f"invalid: {where}: invalid uav state", "hello 1", "open free_flight 5 pelicans_0 1", "restart 6 9"]
    expected += ["readings 5 4", f"watched {0.02:.17g}"]
    said = done.stdout.splitlines()
    assert said[: len(expected)] == expected
    reason, world, owned, closed, no_task, nobody, quit_ = said[len(expected) :]
    assert world == "world box pelicans_0"
    assert owned.startswith(f"owned: {where}: CLAIM: this server's worlds are flown by one client each")
    assert reason.startswith("reason out_of_area: position_ned.z = ")
    assert reason.endswith("measured is NaN: 1")
    assert closed == f"closed: {where}: this client is closed"
    assert "no task is called 'TaskKeepSpott'; did you mean 'TaskKeepSpot'?" in no_task
    assert nobody == "nobody: cannot connect to 127.0.0.1:1: Connection refused"
    assert quit_ == "quit ''"
    served.thread.join(30.0)
    assert not served.thread.is_alive()


def test_a_client_in_cpp_shares_a_world(build):
    """At a barrier, with a client in Python that has the other vehicle."""
    program = build("sharing_tour", (Path(__file__).parent / "sharing_tour.cpp").read_text("utf-8"))
    with running(Tasks(pair()), pace="barrier", seed=SEED) as found, Client(port=found.port) as other:
        other.claim("vehicles_1")
        words = [program, str(found.port), "vehicles_0"]
        with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "claimed vehicles_0 of pair, barrier\n"
            for _ in range(4):
                other.advance({"vehicles_1": ("velocity", [0.0, 1.0, 0.0, 0.0])}, ticks=10)
            said, complaints = process.communicate(timeout=60.0)
    assert (complaints, process.returncode) == ("", 0)
    here = Simulation(pair().world(), seed=SEED)
    here.reset()
    here.step(
        {
            "vehicles_0": qrsim.VelocityHeightSetpoint.of(np.array([[1.0, 0.5]]), -11.0, 0.2),
            "vehicles_1": qrsim.VelocitySetpoint.of([[0.0, 1.0, 0.0]]),
        },
        ticks=40,
    )
    numbers = " ".join(f"{value:.17g}" for value in np.asarray(here.truth.state[0], np.float64))
    gnss = here.reading.gnss
    fresh, taken = int(gnss.fresh[0]), f"{gnss.time_of_reading[0]:.17g}"
    assert said.splitlines() == [
        f"tick 40 {numbers}",
        f"gnss {fresh} {taken} {gnss.position_ned[0, 0]:.17g}",
        "pushed 40",
        "flies command 0",
    ]


RADIO_TOUR = """
#include <cstdio>
#include <string>
#include "qrsim_client.hpp"
int main(int, char** words) try {
  qrsim::Client client("127.0.0.1", std::stoi(words[1]));
  qrsim::SessionOptions options;
  options.task = "pair";
  client.open(options);
  client.say({{"vehicles_0", {1.5, -2.0}}}, "vehicles_1");
  client.step_waypoint(0.1, {{3.0, 0.0, -11.0, 0.0}, {3.0, 9.0, -11.0, 0.0}});
  const auto inbox = client.inbox();
  const qrsim::Heard& heard = inbox.at("vehicles_1").at(0);
  std::printf("%d %s %g %g %g %d\\n", static_cast<int>(inbox.at("vehicles_0").size()), heard.sender.c_str(),
              heard.received, heard.payload[0], heard.payload[1], heard.rssi < 0.0);
  try {
    client.say({{"vehicles_2", {1.0}}});
  } catch (const qrsim::Refused& error) {
    std::printf("%s\\n", error.what());
  }
  client.disconnect();
  return 0;
} catch (const qrsim::Error& error) {
  std::fprintf(stderr, "%s\\n", error.what());
  return 1;
}
"""


def test_a_client_in_cpp_says_and_hears_messages(build):
    program = build("radio_tour", RADIO_TOUR)
    radio = {"preset": "sik_915", "beacon": False, "size": 2, "inbox": {"size": 2, "candidates": 1}}
    with running(Tasks(pair(radio=radio)), seed=SEED) as found:
        said = subprocess.run([program, str(found.port)], capture_output=True, text=True, timeout=120.0)
    assert (said.stderr, said.returncode) == ("", 0)
    heard, refused = said.stdout.splitlines()
    assert heard == "0 vehicles_0 0.02 1.5 -2 1"
    assert refused.endswith("say: vehicle: no vehicle is called 'vehicles_2'; did you mean 'vehicles_1'?")


def tour_line(what: str, simulation: qrsim.Simulation) -> str:
    numbers = " ".join(f"{value:.17g}" for value in np.asarray(simulation.truth.state[0], np.float64))
    return f"{what} t {simulation.time:.17g} vehicles 1/1 reasons 0 {numbers}"


@pytest.mark.nightly
def test_the_examples_fly(build, served):
    """The one beside the header, and those of its README and of docs/howto/tcp_client.md, written for port 10000."""
    done = subprocess.run(
        [build("fly", (HEADER / "fly.cpp").read_text("utf-8")), str(served.port)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert (done.stderr, done.returncode) == ("", 0)
    assert done.stdout.splitlines()[-1].startswith("t = 10 s: ")
    for page in (HEADER / "README.md", ROOT / "docs" / "howto" / "tcp_client.md"):
        [text] = re.findall(r"^```cpp\n(.*?)^```$", page.read_text("utf-8"), re.MULTILINE | re.DOTALL)
        assert "10000" in text
        program = build(page.stem, text.replace("10000", str(served.port)))
        done = subprocess.run([program], capture_output=True, text=True, check=False, timeout=120)
        assert (done.stderr, done.returncode) == ("", 0), page


def test_cmake_builds_the_example(build, served, tmp_path):
    if shutil.which("cmake") is None:
        pytest.skip("no cmake: apt-get install cmake")
    for words in (["-B", str(tmp_path), str(HEADER)], ["--build", str(tmp_path)]):
        subprocess.run(["cmake", *words], check=True, capture_output=True)
    done = subprocess.run(
        [tmp_path / "fly", str(served.port)], capture_output=True, text=True, check=False, timeout=120
    )
    assert (done.stderr, done.returncode) == ("", 0)
