"""Programs of this process, each made once."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

from qrsim.core.garbage import uncollected
from qrsim.core.sameness import is_gone
from qrsim.engine.llvm.refusal import UnsupportedError
from qrsim.errors import CompilerWarning

K = TypeVar("K")
T = TypeVar("T")
log = logging.getLogger(__name__)
# By all that they depend on, the last used at the end; in the place of what cannot be made, the reason.
_MADE: dict[tuple[Hashable, ...], Any] = {}
# Limits of what is kept; a policy whose attributes change is another program each time. In memory, code takes about
# twice its bytes.
MOST_MADE, MOST_BYTES = 256, 2**27
# The reasons that a user has heard.
_TOLD: set[str] = set()


def compiled(key: tuple[Hashable, ...], make: Callable[[], T]) -> T:
    """Return the compiled program with this key in this process, made by ``make`` at the first call.

    Args:
        key: all that it depends on; its first part says what it is.
        make: returns the program.

    Raises:
        UnsupportedError: it cannot be made.
    """
    found = _MADE.get(key)
    if found is None:
        try:
            with uncollected():
                found = make()
        except UnsupportedError as why:
            _tell(key[0], why)
            found = why.again()
        discard_unused(_MADE)
    _MADE.pop(key, None)
    _MADE[key] = found
    if isinstance(found, UnsupportedError):
        raise found.again()
    return found


def discard_unused(made: dict[K, T]) -> None:
    """Discard those in ``made`` of objects that no longer exist, and the oldest beyond limits of number and size.

    Sessions of a server call this in threads, so it works on copies, and an entry may have been discarded already.
    """
    for key in list(made):
        if is_gone(key):
            made.pop(key, None)
    left, size = len(made), sum(map(_code_bytes, list(made.values())))
    for key, program in list(made.items()):
        if left < MOST_MADE and size <= MOST_BYTES:
            break
        made.pop(key, None)
        left, size = left - 1, size - _code_bytes(program)


def _code_bytes(program: object) -> int:
    """Return the size [bytes] of a program's machine code, 0 if unknown."""
    return getattr(program, "code_bytes", 0)


def _tell(program: object, why: UnsupportedError) -> None:
    """Warn that XLA compiles a program that LLVM cannot (``why``), once per reason and process."""
    log.debug("'%s' is compiled by XLA, because of %s", program, why, exc_info=why)
    if str(why) not in _TOLD:
        _TOLD.add(str(why))
        text = f"computed by XLA, which takes longer, because qrsim's own compiler does not take {why}"
        warnings.warn(f"{program}: {text} (QRSIM_COMPILER=xla asks for XLA)", CompilerWarning, stacklevel=2)


def forget() -> None:
    """Discard all compiled programs of this process."""
    _MADE.clear()
    _TOLD.clear()
