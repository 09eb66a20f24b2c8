"""Programs of this process, each made once."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from qrsim.native.cache import kept
from qrsim.native.graph import UnsupportedError

log = logging.getLogger(__name__)
# By all that they depend on; in the place of what cannot be made, the reason.
_MADE: dict[Any, Any] = {}


def once(
    key: tuple[Any, ...], what: tuple[Any, ...] | None, make: Callable[[], Any], load: Callable[[Any], Any]
) -> Any:
    """Return a program of this process; loaded from the user's cache, or made, where there is none yet.

    Args:
        key: all that it depends on; its first part says what it is.
        what: the same as text, for the user's cache; None where another process could not tell it by text.
        make: returns what the cache keeps.
        load: returns a program from that.

    Raises:
        UnsupportedError: it cannot be made.
    """
    if key not in _MADE:
        try:
            _MADE[key] = load(make() if what is None else kept(what, make))
        except UnsupportedError as why:
            log.debug("'%s' is compiled by XLA, because of %s", key[0], why)
            _MADE[key] = why
    found = _MADE[key]
    if isinstance(found, UnsupportedError):
        raise found
    return found


def forget() -> None:
    """Let every program be made anew, for whoever changed what they are made of."""
    _MADE.clear()
