"""A pause of Python's cyclic garbage collector."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def uncollected() -> Iterator[None]:
    """Context manager that pauses the cyclic garbage collector while many objects are made.

    Imports, tracing and compiling make many objects that live on. The collector would walk through all of them, and all
    of JAX, again and again, which takes a third of the time of a compilation and a tenth of that to open a page.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
