"""``qrsim view``: what is shown of a recording, and what is refused."""

from __future__ import annotations

import json
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from urllib.request import urlopen

import numpy as np
import pytest
from tests.apps.conftest import DURATION, Flight
from tests.interrupting import INTERRUPTIBLE
from tests.runs.small_run import COLUMNS, VEHICLES
from tests.small_worlds import bare_pair
from tests.view.fetching import fetching

from qrsim import cli
from qrsim.runs import RunInfo, RunWriter, open_run
from qrsim.runs.recorder import fly
from qrsim.view.recording import Recording


@pytest.fixture
def copy(flown: Flight, tmp_path: Path) -> Path:
    """A run folder of one's own."""
    return Path(shutil.copytree(flown.folder, tmp_path / "run"))


class TestRecording:
    def test_frames_are_what_was_recorded(self, flown: Flight):
        run = open_run(flown.folder)
        recording = Recording(run)
        truth, measured, wind = run["truth"], run["measurements"], run["wind"]
        row = 250
        time = float(truth.time[row])
        frame = recording.frame(time)
        assert frame.time == time
        assert recording.end == pytest.approx(DURATION)
        for i, axis in enumerate("xyz"):
            np.testing.assert_array_equal(frame.position_ned[:, i], np.float32(truth[f"position_ned.{axis}"][row]))
            np.testing.assert_array_equal(frame.ghost_ned[:, i], measured[f"gnss.position_ned.{axis}"][row])
            np.testing.assert_array_equal(frame.wind_ned[:, i], wind[f"mean_ned.{axis}"][row])
            np.testing.assert_array_equal(frame.gust_ned[:, i], wind[f"gust_ned.{axis}"][row])
        np.testing.assert_array_equal(frame.attitude[:, 2], truth["attitude.yaw"][row])
        # What the controllers are fed with: horizontal GNSS and the barometer.
        np.testing.assert_array_equal(frame.estimate_ned[:, :2], frame.ghost_ned[:, :2])
        np.testing.assert_array_equal(frame.estimate_ned[:, 2], -measured["barometer.height"][row])
        assert frame.valid.all()

    def test_between_ticks_the_last_one_counts(self, flown: Flight):
        recording = Recording(open_run(flown.folder))
        assert recording.frame(1.0).time == recording.frame(1.0199).time == pytest.approx(1.0)
        # 0.3 is no float; it is the fifteenth tick all the same.
        assert recording.frame(0.3).time == pytest.approx(0.3)

    def test_long_logs_are_thinned_out(self, flown: Flight, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr("qrsim.view.columns.MOST_POSES", 600)
        recording = Recording(open_run(flown.folder))
        assert recording.shown == 5
        whole = open_run(flown.folder)["truth"]
        np.testing.assert_array_equal(recording.time, whole.time[::5])
        np.testing.assert_array_equal(recording.frame(5.0).position_ned[:, 0], np.float32(whole["position_ned.x"][250]))

    def test_stopped_vehicles_say_why(self, fly):
        flight = fly("--duration", "3", "--no-figure", "--set", "fleets.pelicans.limits.rate=0.4")
        assert flight.code == 0, flight.complaints
        run = open_run(flight.folder)
        stops = {event.vehicle: event for event in run.events if event.kind == "state_limit"}
        assert stops, "nobody turned too fast: the test shows nothing"
        recording = Recording(run)
        vehicle, event = next(iter(stops.items()))
        i = run.vehicles.index(vehicle)
        before, after = recording.frame(event.time - 0.04), recording.frame(event.time)
        assert i not in before.reasons
        assert before.valid[i]
        assert not after.valid[i]
        assert "turned faster than its model holds for" in after.reasons[i]

    def test_a_run_whose_scenario_is_gone_is_shown_without_area(self, copy: Path):
        (copy / "scenario.yaml").write_text("name: [", encoding="utf-8")
        with pytest.warns(UserWarning, match="its area is not shown"):
            recording = Recording(open_run(copy))
        assert recording.world is None
        assert recording.cast.names == recording.run.vehicles


class TestRefused:
    @pytest.mark.parametrize(
        ("words", "said"),
        [
            (["--at", "11"], "--at 11: the recording ends at 10 s"),
            (["--at", "-1"], "--at -1: expected a number of seconds"),
            (["--at", "nan"], "--at nan"),
            (["--screenshot", "a.jpg"], "has to end in .png"),
            (["--screenshot", "nowhere/a.png"], "there is no folder nowhere"),
            (["--port", "70000"], "--port 70000: expected 0 to 65535"),
            (["--size", "100x100"], "--size: only for a picture; add --screenshot FILE.png"),
            (["--camera", "above", "--layers", "all"], "--camera, --layers: only for a picture"),
            (["--screenshot", "a.png", "--size", "10x10"], "--size 10x10: expected WIDTHxHEIGHT"),
            (["--screenshot", "a.png", "--camera", "abve"], "no such view; did you mean 'above'?"),
            (["--screenshot", "a.png", "--layers", "gust"], "no layer 'gust'; did you mean 'gusts'?"),
        ],
    )
    def test_wrong_options(self, words: list[str], said: str, flown: Flight, refused):
        refused(["view", str(flown.folder), *words], said)

    def test_no_run(self, tmp_path: Path, refused):
        refused(["view", str(tmp_path / "nothing")], "there is no such folder")
        refused(["view", str(tmp_path)], "is not a run folder")

    def test_a_later_format(self, copy: Path, refused):
        info = json.loads((copy / "run.json").read_text("utf-8"))
        (copy / "run.json").write_text(json.dumps({**info, "format": 2}), encoding="utf-8")
        refused(["view", str(copy)], "run folder format 2", "reads format 1", code=1)

    def test_a_damaged_log(self, copy: Path, refused):
        part = next((copy / "truth").glob("part-*.parquet"))
        part.write_bytes(part.read_bytes()[:1000])
        refused(["view", str(copy)], str(part), "cannot be read", code=1)

    def test_logs_that_are_missing(self, copy: Path, refused):
        shutil.rmtree(copy / "truth")
        refused(["view", str(copy)], "truth", "it is missing", code=1)

    def test_logs_of_something_else(self, tmp_path: Path, refused):
        info = RunInfo.collect(scenario="x", seed=1, precision="float64", time_step=0.02, vehicles=VEHICLES)
        columns = {stream: found for stream, found in COLUMNS.items() if stream != "truth"}
        with RunWriter.create(tmp_path / "run", info=info, scenario_yaml="name: x\n", columns=columns):
            pass
        refused(["view", str(tmp_path / "run")], "no true positions (truth.position_ned) were recorded", code=1)

    def test_an_export_overwrites_nothing(self, flown: Flight, tmp_path: Path, refused):
        (tmp_path / "kept.txt").write_text("kept", encoding="utf-8")
        refused(["view", str(flown.folder), "--export", str(tmp_path)], "it exists and is not empty")
        assert [path.name for path in tmp_path.iterdir()] == ["kept.txt"]

    def test_no_browser_and_no_viser_are_said_with_how_to_install(
        self, flown: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused
    ):
        words = ["view", str(flown.folder), "--screenshot", str(tmp_path / "a.png")]
        monkeypatch.setattr("qrsim.view.browser.NAMES", ("no-such-browser",))
        refused(words, "no-such-browser not found", "apt-get install chromium", code=1)
        monkeypatch.setitem(sys.modules, "viser", None)
        refused(words, "pip install 'qrsim[view]'")


@pytest.mark.long
def test_two_pages_of_one_run_and_their_end(flown: Flight):
    """In processes of their own, on two ports; Ctrl-C ends them."""
    command = [sys.executable, "-c", INTERRUPTIBLE, "view", str(flown.folder)]
    pages = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1)
        for _ in range(2)
    ]
    addresses = []
    for page in pages:
        assert page.stdout is not None
        line = page.stdout.readline()
        assert line.startswith("outdoor_patrol, seed 3, 5 vehicles, 10 s: http://127.0.0.1:")
        addresses.append(line.split(": ")[1].split()[0])
    assert addresses[0] != addresses[1]
    for page, address in zip(pages, addresses, strict=True):
        with urlopen(address, timeout=60.0) as answer:
            assert b"<html" in answer.read(2000)
        page.send_signal(signal.SIGINT)
    for page in pages:
        _, complaints = page.communicate(timeout=60.0)
        assert (page.returncode, complaints) == (130, "interrupted\n")


def test_a_run_prints_where_its_page_is(fly):
    flight = fly("--duration", "0.4", "--no-figure", "--view", "--view-port", "0", "--json")
    assert flight.code == 0
    assert flight.complaints.startswith("page: http://127.0.0.1:")
    assert flight.json["simulated_s"] == pytest.approx(0.4)


@pytest.mark.long
def test_a_browser_that_goes_away_ends_no_run(tmp_path: Path):
    """Closed without a word in mid-run; another one gets the page, and Ctrl-C ends the run as always."""
    words = ["patrol_plain", "--duration", "900", "--view", "--view-port", "0", "--out", str(tmp_path / "run")]
    command = [sys.executable, "-c", INTERRUPTIBLE, "run", *words]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1)
    assert running.stderr is not None
    line = running.stderr.readline()
    assert line.startswith("page: http://127.0.0.1:")
    address = line.split()[1]
    # Browsers do that too.
    socket.create_connection(("127.0.0.1", int(address.rpartition(":")[2]))).close()
    for _ in range(2):
        with fetching(address) as browser:
            for _ in range(20):
                browser.recv(60.0)
            # So that no closing handshake is made.
            browser.socket.shutdown(socket.SHUT_RDWR)
    running.send_signal(signal.SIGINT)
    printed, complaints = running.communicate(timeout=60.0)
    assert (running.returncode, printed) == (130, "")
    assert f"interrupted; the log so far is in {tmp_path / 'run'}" in complaints
    assert "Traceback" not in complaints
    run = open_run(tmp_path / "run")
    assert run.info.state == "interrupted"
    assert run["truth"].tick[-1] == run.info.ticks > 0


def test_a_server_with_a_page_has_one_session(refused):
    refused(["serve", "--view", "--sessions"], "it shows one simulation")


@pytest.mark.long
def test_without_looking_nothing_of_the_page_is_imported():
    """So 'make run' needs no viser."""
    code = "import sys, qrsim.cli, qrsim.runs.recorder; print('viser' in sys.modules, 'qrsim.view.live' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False False\n"
    assert cli.COMMANDS["view"] is not None


OPENED = """
import sys
from pathlib import Path
from jax._src.xla_bridge import backends_are_initialized
from qrsim import cli
from qrsim.apps.view import View
from qrsim.view.clock import Clock
from qrsim.view.server import start_server
view = View([Path(sys.argv[1])])
view._replay(start_server(0), view._opened(), Clock())
slow = ("llvmlite", "matplotlib", "pandas", "qrsim.engine.backend", "qrsim.simulation.simulation", "scipy")
print([name for name in slow if name in sys.modules], backends_are_initialized(), flush=True)
"""


@pytest.mark.long
def test_the_page_of_a_saved_run_needs_no_compiler(tmp_path: Path):
    """Each of these takes a part of the time until it is shown."""
    fly(bare_pair(duration=0.1), tmp_path / "run", seed=1, precision="float32")
    words = [sys.executable, "-c", OPENED, str(tmp_path / "run")]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stdout == "[] False\n"


def test_an_export_that_does_not_fit_and_what_is_thinned_are_said(
    flown: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr("qrsim.view.film.MOST_FRAMES", 11)
    monkeypatch.setattr("qrsim.view.film.shutil.disk_usage", lambda _: SimpleNamespace(free=1000))
    assert cli.main(["view", str(flown.folder), "--export", str(tmp_path / "page")]) == 1
    said = capsys.readouterr().err
    assert "so long a run is exported at every 1 s" in said
    assert "MB, 0.001 MB are free" in said
    assert not (tmp_path / "page" / "index.html").exists()


def test_a_run_that_is_being_written_is_said(copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    """By each command that reads it, in one line."""
    info = json.loads((copy / "run.json").read_text("utf-8"))
    (copy / "run.json").write_text(json.dumps({**info, "state": "running"}), encoding="utf-8")
    monkeypatch.setattr("qrsim.view.film.MOST_FRAMES", 2)
    assert cli.main(["view", str(copy), "--export", str(tmp_path / "page")]) == 0
    note = "the run has not ended; shown up to 10 s, the last flush"
    assert note in capsys.readouterr().err
    assert note in (tmp_path / "page" / "index.html").read_text("utf-8")
    for words in (["plot", "--out", "a.png"], ["export", "--format", "csv", "--stream", "events", "--out", "a.csv"]):
        path = [str(tmp_path / word) if word.startswith("a.") else word for word in words[1:]]
        assert cli.main([words[0], str(copy), *path]) == 0
        said = capsys.readouterr().err.splitlines()
        assert said == [f"{copy}: the run has not ended, or was killed; the data end at its last flush"]


@pytest.mark.long
def test_a_run_is_exported_while_it_is_written(tmp_path: Path, capsys):
    """A flight in a process of its own; what is on the page ends at a flush."""
    words = ["patrol_plain", "--duration", "900", "--realtime", "--no-figure", "--out", str(tmp_path / "run")]
    running = subprocess.Popen([sys.executable, "-c", INTERRUPTIBLE, "run", *words], stderr=subprocess.DEVNULL)
    try:
        end = time.monotonic() + 90.0
        while not (tmp_path / "run" / "truth" / "part-00001.parquet").exists():
            assert time.monotonic() < end, "it never flew"
            time.sleep(0.2)
        for number in range(2):
            assert cli.main(["view", str(tmp_path / "run"), "--export", str(tmp_path / f"page{number}")]) == 0
            said = capsys.readouterr().err.splitlines()
            assert len(said) == 1
            assert said[0].startswith("the run has not ended; shown up to ")
    finally:
        running.send_signal(signal.SIGINT)
    assert running.wait(60.0) == 130
