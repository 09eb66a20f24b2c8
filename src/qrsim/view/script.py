"""Scripts of the page that viser has not: they are sent as its messages, and run in browsers and in exported pages."""

from __future__ import annotations

from typing import Any

from viser._messages import RunJavascriptMessage


class _Script(RunJavascriptMessage, include_in_scene_serialization=True):
    """A script of which only the last of its kind is kept for browsers that come later."""

    kind = ""

    def redundancy_key(self) -> str:
        """Return a key such that a later script of the same kind replaces this one."""
        return f"qrsim-{self.kind}"


class _PageScript(_Script, include_in_scene_serialization=False):
    """One that an exported page has no use for."""


# They go by this name in browsers.
_Script.__name__ = _PageScript.__name__ = RunJavascriptMessage.__name__


def run_script(to: Any, kind: str, source: str, exported: bool = True) -> None:
    """Run JavaScript in all browsers, or one client's; the last script of a ``kind`` also runs in later browsers."""
    script = (_Script if exported else _PageScript)(f"{{{source}}}")
    script.kind = kind
    (to._websock_server if hasattr(to, "_websock_server") else to._websock_connection).queue_message(script)
