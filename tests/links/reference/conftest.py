"""A server that the tests share, and connections to it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import pytest
from shared_worlds import Clients, sharing
from wires import Running, Wire, running


@pytest.fixture(scope="session")
def serving() -> Iterator[Running]:
    """The server that most tests share: one client at a time."""
    with running(max_clients=200) as found:
        yield found


@pytest.fixture
def connect(serving: Running) -> Iterator[Callable[[], Wire]]:
    """Return a function that connects to the shared server; everything is closed after the test."""
    with contextlib.ExitStack() as stack:
        yield lambda: stack.enter_context(Wire(serving.port))


@pytest.fixture
def wire(connect: Callable[[], Wire]) -> Wire:
    """A connection to the shared server."""
    return connect()


@pytest.fixture(scope="module")
def barrier() -> Iterator[tuple[Running, Clients]]:
    with sharing(pace="barrier") as found:
        yield found


@pytest.fixture(scope="module")
def free() -> Iterator[tuple[Running, Clients]]:
    with sharing(pace="free", realtime=1.0) as found:
        yield found
