"""Servers whose clients share a world of two vehicles, and what their tests have in common."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from wires import Running, running

from qrsim.links.reference.client import Client
from qrsim.links.reference.tasks import Tasks
from small_worlds import pair

A, B = "vehicles_0", "vehicles_1"
SEED = 5
Clients = Callable[[], Client]


@contextlib.contextmanager
def sharing(**options: Any) -> Iterator[tuple[Running, Clients]]:
    """Serve the pair; hand out clients, which are closed at the end."""
    with contextlib.ExitStack() as stack:
        found = stack.enter_context(running(Tasks(pair()), seed=SEED, **options))
        yield found, lambda: stack.enter_context(Client(port=found.port))


def together(*calls: Callable[[], Any]) -> list[Any]:
    """Make calls at the same time, each a little later than the one before; return what they return."""
    found: list[Any] = [None] * len(calls)

    def call(number: int) -> None:
        found[number] = calls[number]()

    threads = [threading.Thread(target=call, args=(number,)) for number in range(len(calls))]
    for thread in threads:
        thread.start()
        time.sleep(0.002)
    for thread in threads:
        thread.join(30.0)
    return found


def goal(vehicle: int, k: int) -> list[float]:
    return [3.0 + 0.25 * k, 9.0 * vehicle - 0.125 * k, -11.0, 0.1 * k]


@contextlib.contextmanager
def alone(client: Client, seed: int | None = None) -> Iterator[None]:
    """Begin an episode, and leave nothing claimed."""
    client.restart(SEED if seed is None else seed)
    yield
    client.release()
