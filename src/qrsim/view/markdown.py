"""Text inside of Markdown, which the page renders with whatever HTML is in it."""

from __future__ import annotations

import re

_MEANS_SOMETHING = re.compile(r"[&<>\[\]{}()*_`~#|!\\$^\"'=+]")


def plain(text: str) -> str:
    """Return untrusted text as one line, escaped so that none of it acts as Markdown, HTML or code."""
    line = "".join(character if character.isprintable() else " " for character in text)
    return _MEANS_SOMETHING.sub(lambda found: f"&#{ord(found[0])};", line)
