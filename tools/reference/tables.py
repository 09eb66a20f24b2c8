"""Tables and other Markdown that all generated pages write alike."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table, without the columns that are empty in every row."""
    body = [[cell(each) for each in row] for row in rows]
    kept = [i for i in range(len(head)) if i == 0 or any(row[i] for row in body)]
    lines = [[head[i] for i in kept], ["---"] * len(kept), *([row[i] for i in kept] for row in body)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def cell(text: str) -> str:
    """Return a text as it can stand in a cell: one line, bars escaped."""
    return " ".join(text.split()).replace("|", "\\|")


def code(text: Any) -> str:
    """Return a text as code, "" for nothing."""
    return f"`{text}`" if str(text) else ""


def sentence(text: str) -> str:
    """Return a text that begins with a capital, unless its first word is a name or code; two brackets are no link."""
    text = text.replace("] [", "] \\[")
    first = text.split(" ", 1)[0]
    return text[:1].upper() + text[1:] if first.rstrip(",;:").isalpha() and first.islower() else text


def number(value: Any) -> str:
    """Return a number without trailing zeros, six digits of it at most; anything else as YAML writes it."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g}".replace("e+0", "e").replace("e-0", "e-")
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(number, value))}]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name}: {number(each)}" for name, each in value.items()) + "}"
    return str(value)


def page(title: str, introduction: str, *parts: str) -> str:
    """Return a page of a title, an introduction and parts."""
    return "\n\n".join([f"# {title}", " ".join(introduction.split()), *parts])
