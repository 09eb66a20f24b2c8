"""The life of a live page: before a flight, after it, and how long it stays."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.interrupting import INTERRUPTIBLE
from tests.small_worlds import bare_pair
from tests.view.fetching import fetching

from qrsim.runs import open_run
from qrsim.runs.recorder import fly
from qrsim.view.clock import Clock
from qrsim.view.flight import completed
from qrsim.view.live import LiveView
from qrsim.view.recording import Recording


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        (["--view"], ["--view=now"]),
        (["--view", "patrol_plain"], ["--view=now", "patrol_plain"]),
        (["a", "--view", "--json"], ["a", "--view=now", "--json"]),
        (["--view", "wait"], ["--view", "wait"]),
        # A wrong word is for the parser to refuse.
        (["--view", "wiat"], ["--view", "wiat"]),
        (["--view=wait"], ["--view=wait"]),
    ],
)
def test_view_alone_means_now(given: list[str], meant: list[str]):
    assert completed(given) == meant


def test_a_page_without_a_world_says_what_it_waits_for():
    page = LiveView(0)
    with contextlib.closing(page):
        page.wait_for("a client that connects to 127.0.0.1:10000")
        assert page._waiting.content == "**qrsim**  \nThis page waits for a client that connects to 127.0.0.1:10000."
        sent = page._server._websock_server._broadcast_buffer.message_from_id.values()
        assert [m.source for m in sent if hasattr(m, "source")] == ['{document.title = "qrsim"}']


def test_a_live_page_becomes_a_replay_with_what_was_chosen(tmp_path: Path):
    scenario = bare_pair(duration=1.0)
    page = LiveView(0, Clock(float("inf")))
    with contextlib.closing(page):
        fly(scenario, tmp_path / "run", seed=1, precision="float32", view=page)
        live = page._page
        assert live is not None
        live.choose(1)
        live.scene.show("poles", False)
        page.replay(Recording(open_run(tmp_path / "run")))
        after, clock = page._page, page.clock
        assert after is not None
        assert clock is not None
        assert after is not live
        assert (after.chosen, after.scene.layers["poles"].root.visible, clock.playing) == ({1}, False, False)
        assert after.scene.frame is not None
        assert after.scene.frame.time == pytest.approx(1.0)
        assert "The flight has ended, at 1 s. This is its replay." in after._status.content
        # It plays, from the begin.
        clock.speed, clock.playing = 0.5, True
        end = time.monotonic() + 20.0
        while not 0.0 < after.scene.frame.time < 0.9:
            assert time.monotonic() < end, "it does not play"
            time.sleep(0.01)


@pytest.mark.nightly
def test_a_run_waits_for_its_browser_and_stays_while_it_looks(tmp_path: Path):
    """Without a terminal: the flight begins with the first browser, the page ends with the last one."""
    words = ["patrol_plain", "--duration", "1", "--no-figure", "--view", "wait", "--view-port", "0"]
    command = [sys.executable, "-c", INTERRUPTIBLE, "run", *words, "--out", str(tmp_path / "run")]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1)
    assert running.stderr is not None
    assert running.stdout is not None
    address = running.stderr.readline().split()[1]
    time.sleep(3.0)
    assert not (tmp_path / "run").exists(), "it did not wait"
    with fetching(address) as browser:
        browser.send(CAMERA)
        while "run folder" not in (line := running.stdout.readline()):
            assert line, "it ended without a result"
        time.sleep(4.0)
        assert running.poll() is None, "the page was gone while somebody looked at it"
    assert running.wait(30.0) == 0


def camera() -> bytes:
    """Return what a browser says first: where it looks from."""
    import msgspec

    found = {
        "type": "ViewerCameraMessage",
        "wxyz": (1.0, 0.0, 0.0, 0.0),
        "position": (1.0, 1.0, 1.0),
        "fov": 1.0,
        "image_height": 100,
        "image_width": 100,
        "near": 0.1,
        "far": 100.0,
        "look_at": (0.0, 0.0, 0.0),
        "up_direction": (0.0, 0.0, -1.0),
    }
    return msgspec.msgpack.encode(found)


CAMERA = camera()
