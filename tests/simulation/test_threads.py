"""One thread flies a simulation; another that tries to is told so, and harms nothing."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from tests.small_worlds import noisy_pair

from qrsim.errors import BusyError, RunError
from qrsim.simulation.simulation import Simulation

CALLS = ("reset", "step", "advance", "record", "set_state", "save", "load", "change_world")


def fresh() -> Simulation:
    simulation = Simulation(noisy_pair().world(), seed=5, name="pair")
    simulation.reset()
    return simulation


@pytest.fixture(scope="module")
def expected() -> bytes:
    """The state after 40 000 ticks in a call, flown alone."""
    simulation = fresh()
    simulation.step(ticks=40_000)
    return simulation.save()


class InAThread:
    """A simulation that another thread is flying, in one call of many ticks."""

    def __init__(self) -> None:
        self.simulation = fresh()
        self.saved, self.world = self.simulation.save(), self.simulation.world
        self.inside = threading.Event()
        advance = self.simulation._ticks.advance

        def slow(*arguments: Any) -> Any:
            self.inside.set()
            self.go_on.wait(60)
            return advance(*arguments)

        self.go_on = threading.Event()
        self.simulation._ticks.advance = slow  # type: ignore[method-assign]
        self.thread = threading.Thread(target=self.simulation.step, kwargs={"ticks": 40_000})
        self.thread.start()
        assert self.inside.wait(60)

    def finish(self) -> None:
        self.go_on.set()
        self.thread.join(60)


@pytest.fixture
def flying() -> Iterator[InAThread]:
    found = InAThread()
    yield found
    found.finish()


def test_whatever_changes_or_saves_the_state_is_refused(flying: InAThread, expected: bytes) -> None:
    given = {
        "record": (1,),
        "set_state": (np.zeros((2, 3)),),
        "load": (flying.saved,),
        "change_world": (flying.world,),
    }
    for name in CALLS:
        with pytest.raises(BusyError, match=f"^{name}: another thread is flying this simulation"):
            getattr(flying.simulation, name)(*given.get(name, ()))
    flying.finish()
    assert flying.simulation.save() == expected


def test_it_is_an_error_of_the_package_and_of_python() -> None:
    assert issubclass(BusyError, RunError)
    assert issubclass(BusyError, RuntimeError)


def test_who_looks_waits_and_sees_a_state_between_two_steps(flying: InAThread) -> None:
    seen = []
    looking = threading.Thread(target=lambda: seen.append((flying.simulation.reading.time, flying.simulation.tick)))
    looking.start()
    looking.join(0.1)
    assert not seen
    flying.finish()
    looking.join(60)
    assert seen == [(pytest.approx(800.0), 40_000)]


def test_threads_that_take_turns_are_fine(expected: bytes) -> None:
    simulation = fresh()
    for _ in range(4):
        thread = threading.Thread(target=simulation.step, kwargs={"ticks": 10_000})
        thread.start()
        thread.join()
    assert simulation.save() == expected


def test_two_threads_at_once_give_errors_and_no_wrong_state() -> None:
    """Every step is either done as if alone or refused."""
    simulation, done, both = fresh(), [], threading.Barrier(2)

    def fly() -> None:
        both.wait(60)
        for _ in range(300):
            with contextlib.suppress(BusyError):
                simulation.step(ticks=20)
                done.append(1)

    threads = [threading.Thread(target=fly) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert simulation.tick == 20 * len(done)
    alone = fresh()
    for _ in done:
        alone.step(ticks=20)
    assert simulation.save() == alone.save()


def test_an_error_inside_sets_it_free() -> None:
    simulation = fresh()
    with pytest.raises(ValueError, match="ticks"):
        simulation.step(ticks=0)
    thread = threading.Thread(target=simulation.step)
    thread.start()
    thread.join()
    assert simulation.tick == 1
