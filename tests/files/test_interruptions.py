"""Ctrl-C and SIGTERM end whatever goes on, wherever they come; the long tests press them at random moments."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import gc
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from tests.interrupting import INTERRUPTIBLE

from qrsim import cli
from qrsim.files.interruptions import WORDS, Interruption, calling, exit_code, heard, run_until_signal, word

# ruff: noqa: PT012 (it is raised somewhere in a block)
pytestmark = [
    pytest.mark.skipif(os.name != "posix", reason="needs signals"),
    pytest.mark.usefixtures("heeded"),
]
BOTH = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])


def press(number: int) -> None:
    os.kill(os.getpid(), number)
    # The handler runs between two instructions of Python.
    for _ in range(1000):
        pass


def wait() -> None:
    """Go on for as long as nobody wants an end."""
    for _ in range(2000):
        time.sleep(0.005)


class Dying:
    """Something during whose end a signal comes."""

    def __init__(self, number: int):
        self.number = number

    def __del__(self) -> None:
        press(self.number)


@BOTH
class TestNeverLost:
    def test_in_plain_code(self, number: int) -> None:
        with pytest.raises(Interruption) as found, heard():
            press(number)
        assert found.value.number == number

    def test_in_a_callback_of_the_garbage_collector(self, number: int, capfd: pytest.CaptureFixture[str]) -> None:
        def collecting(phase: str, info: Any) -> None:
            if phase == "start":
                gc.callbacks.remove(collecting)
                press(number)

        with pytest.raises(Interruption), heard():
            gc.callbacks.append(collecting)
            gc.collect()
            wait()
        assert capfd.readouterr().err == ""

    def test_again_and_again(self, number: int) -> None:
        """Three in a row are lost, and the fourth is not."""
        times: list[int] = []

        def collecting(phase: str, info: Any) -> None:
            if phase == "start" and len(times) < 3:
                times.append(1)
                time.sleep(0.05)
                press(number)

        with pytest.raises(Interruption), heard():
            gc.callbacks.append(collecting)
            try:
                for _ in range(1000):
                    gc.collect(0)
                    time.sleep(0.005)
            finally:
                gc.callbacks.remove(collecting)

    def test_in_a_destructor(self, number: int) -> None:
        with pytest.raises(Interruption), heard():
            Dying(number)
            wait()

    def test_in_a_callback_of_a_library_in_c(self, number: int) -> None:
        @ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
        def compare(one: Any, other: Any) -> int:
            press(number)
            return 0

        library = ctypes.CDLL(None)
        with pytest.raises(Interruption), heard():
            library.qsort((ctypes.c_int * 2)(2, 1), ctypes.c_size_t(2), ctypes.c_size_t(4), compare)
            wait()

    def test_where_somebody_drops_every_exception(self, number: int) -> None:
        with pytest.raises(Interruption), heard():
            try:
                press(number)
            except BaseException:
                gc.collect()
            wait()

    @pytest.mark.parametrize("module", ["llvmlite.binding.ffi", "jax._src.core", "jaxlib.mlir"])
    def test_not_where_code_in_c_does_not_stand_it(self, number: int, module: str) -> None:
        """Not before it is left, that is."""
        done: list[int] = []
        inside: dict[str, Any] = {"__name__": module, "press": press, "time": time, "done": done}
        exec("def work(number):\n press(number)\n time.sleep(0.1)\n done.append(1)", inside)
        with pytest.raises(Interruption), heard():
            inside["work"](number)
            wait()
        assert done == [1]


class TestInOrder:
    def test_one_that_was_taken_dies_of_old_age_and_ends_nothing_else(self) -> None:
        with pytest.raises(Interruption) as found, heard():
            press(signal.SIGINT)
        kept = [found.value]
        del found
        done = []
        with heard():
            kept.clear()
            gc.collect()
            time.sleep(0.1)
            done.append(1)
        assert done == [1]

    def test_nothing_comes_after_the_end(self) -> None:
        """One that was dropped just before is for its own context, and the next one has handlers of its own."""
        for wait_s in (0.0, 0.018, 0.019, 0.02, 0.021, 0.022):
            with heard():
                Dying(signal.SIGINT)
                with contextlib.suppress(Interruption):
                    time.sleep(wait_s)
            time.sleep(0.03)
        with heard():
            time.sleep(0.05)

    def test_a_second_one_waits_for_the_work_of_the_first(self) -> None:
        """A shell, a supervisor and an impatient user send two; the first one's run is saved meanwhile."""
        done = []
        with pytest.raises(Interruption) as found, heard():
            try:
                press(signal.SIGINT)
            finally:
                press(signal.SIGTERM)
                done.append("saved")
        assert (found.value.number, done) == (signal.SIGINT, ["saved"])

    @pytest.mark.long
    def test_it_does_not_come_again_while_things_are_put_in_order(self) -> None:
        done = []
        with pytest.raises(Interruption), heard():
            try:
                press(signal.SIGINT)
            finally:
                time.sleep(0.2)
                gc.collect()
                done.append("closed")
        time.sleep(0.1)
        assert done == ["closed"]

    def test_what_was_there_before_is_there_after(self) -> None:
        before = [signal.getsignal(number) for number in WORDS], sys.unraisablehook
        with heard():
            assert signal.getsignal(signal.SIGTERM) is not before[0][1]
        assert ([signal.getsignal(number) for number in WORDS], sys.unraisablehook) == before

    def test_what_is_ignored_stays_ignored(self) -> None:
        """As of a process behind nohup or in the background of a script."""
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            with heard():
                press(signal.SIGINT)
        finally:
            signal.signal(signal.SIGINT, before)

    def test_other_threads_are_left_alone(self) -> None:
        found: list[Any] = []

        def inside() -> None:
            with heard():
                found.append(signal.getsignal(signal.SIGTERM))

        thread = threading.Thread(target=inside)
        thread.start()
        thread.join()
        assert found == [signal.getsignal(signal.SIGTERM)]

    @BOTH
    def test_what_is_called_in_its_place(self, number: int) -> None:
        called = []
        with pytest.raises(Interruption) as found, heard(), calling(lambda: called.append(1)):
            press(number)
            called.append(2)
        assert called == [1, 2]
        assert found.value.number == number

    def test_words_and_codes(self) -> None:
        assert [(word(Interruption(n)), exit_code(Interruption(n))) for n in (2, 15)] == [
            ("interrupted", 130),
            ("terminated", 143),
        ]
        assert (word(KeyboardInterrupt()), exit_code(KeyboardInterrupt())) == ("interrupted", 130)

    @BOTH
    def test_a_library_that_makes_another_exception_of_it(
        self, number: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        def dispatch(arguments: list[str]) -> int:
            try:
                press(number)
            except KeyboardInterrupt as error:
                raise ImportError("numpy could not be imported") from error
            return 0

        monkeypatch.setattr(cli, "_dispatch", dispatch)
        assert cli.main([]) == 128 + number
        assert capsys.readouterr().err == f"{WORDS[signal.Signals(number)]}\n"


def ended(folder: Path, tries: int, seed: int, longest_s: float) -> None:
    """Press Ctrl-C or SIGTERM at random moments of starts, and check how each ends."""
    random_times = random.Random(seed)
    for i in range(tries):
        number = random_times.choice([signal.SIGINT, signal.SIGTERM])
        words = ["run", "--realtime", "--duration", "100", "--no-figure", "--out", str(folder / str(i))]
        process = subprocess.Popen(
            # The line that its caller waits for: from there on Ctrl-C is heard.
            [sys.executable, "-c", f"import qrsim.cli; print('ready', flush=True)\n{INTERRUPTIBLE}", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stdout
        assert process.stdout.readline() == "ready\n"
        moment = random_times.uniform(0.05, longest_s)
        time.sleep(moment)
        process.send_signal(number)
        try:
            _, complaints = process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            process.kill()
            pytest.fail(f"{number.name} after {moment:.2f} s was lost")
        where = f"{number.name} after {moment:.2f} s: {complaints}"
        assert process.returncode == 128 + number, where
        assert complaints.splitlines()[-1] == WORDS[number], where
        assert "Traceback" not in complaints, where
        record = folder / str(i) / "run.json"
        assert not record.exists() or json.loads(record.read_text())["state"] == "interrupted", where


@pytest.mark.parametrize(
    "tries", [pytest.param(3, marks=pytest.mark.long), pytest.param(16, marks=pytest.mark.nightly)]
)
def test_at_many_moments_of_a_start(tries: int, tmp_path: Path) -> None:
    ended(tmp_path, tries, seed=2, longest_s=4.0)


class TestCoroutines:
    """A signal cancels what runs, at any moment of the event loop: no wake-up is lost."""

    @BOTH
    def test_it_ends_what_sleeps(self, number: int) -> None:
        ended = []

        async def sleeps() -> None:
            threading.Timer(0.05, press, (number,)).start()
            try:
                await asyncio.sleep(60.0)
            finally:
                ended.append(True)

        with heard(), pytest.raises(Interruption) as said:
            run_until_signal(sleeps())
        assert (said.value.number, ended) == (number, [True])

    def test_it_ends_what_is_about_to_wake(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """An exception here would leave a task that nobody wakes any more, and whose end the loop would wait for."""
        plain, calls = asyncio.Handle._run, [0]

        def pressed(handle: asyncio.Handle) -> None:
            calls[0] += 1
            if calls[0] == 5:
                press(signal.SIGTERM)
            plain(handle)

        async def wakes() -> None:
            while True:
                await asyncio.sleep(0.0)

        monkeypatch.setattr(asyncio.Handle, "_run", pressed)
        with heard(), pytest.raises(Interruption):
            run_until_signal(wakes())

    def test_it_ends_what_does_not_hear(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("qrsim.files.interruptions.PATIENCE_S", 0.1)

        async def busy() -> None:
            threading.Timer(0.05, press, (signal.SIGTERM,)).start()
            begun = time.monotonic()
            while time.monotonic() - begun < 30.0:
                wait()

        begun = time.monotonic()
        with heard(), pytest.raises(Interruption):
            run_until_signal(busy())
        assert time.monotonic() - begun < 20.0

    def test_it_returns_where_nobody_presses(self) -> None:
        came = []

        async def ends() -> None:
            came.append(await asyncio.sleep(0.0, "done"))

        with heard():
            run_until_signal(ends())
        assert came == ["done"]
