"""Hold the numbers of the documentation against docs/evidence: ``python -m evidence.docs [--write]``.

A comment in front of a paragraph, a list or a table names where its numbers come from, in order::

    <!--ev control.steps
    waypoint.height: rise_s overshoot_percent error_percent
    waypoint {north east}: {}.rise_s {}.overshoot_percent
       - -->

The first line has a study and what all its paths begin with. Each line after it has a part of the path and a colon, if
its items share one, and an item for every number of the text: the rest of a path, or ``-`` for a number that is not
measured; ``<`` before a path: the number is a bound of the measured one's magnitude. A line with words in braces stands
for one line for each of them, and an indented line goes on with the one before. The header and the first column of a
table do not count, nor do code, targets of links and words with digits in them. A number may be rounded to any digit.
"""

from __future__ import annotations

import contextlib
import json
import re
import sys
from collections.abc import Iterator, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

from evidence import ROOT

MARKER = re.compile(r"<!--[ ]?ev\b(.*?)-->[ ]*\n?", re.DOTALL)
TAG = re.compile(r"<!--[ ]*/?[ ]*ev\b")
NUMBER = re.compile(r"(?:(?<!\w)[+-])?(?<![\w.^])(\d+(?:\.\d+)?|\.\d+)(e[+-]?\d+)?(?!\w|\.\d)", re.IGNORECASE)
# What is no text: code, targets of links, pictures and addresses.
NO_TEXT = re.compile(r"`[^`]*`|!\[[^\]]*\]\([^)]*\)|\]\([^)]*\)|https?://\S+")
UNMEASURED = "-"


class Shown(NamedTuple):
    """A number of a marked block: where it stands in the page, its text, and the path of its measurement."""

    start: int
    text: str
    path: str


def pages(root: Path) -> list[Path]:
    """Return the Markdown files whose numbers are checked."""
    top = [root / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")]
    return [page for page in top if page.is_file()] + sorted((root / "docs").rglob("*.md"))


def look_up(path: str, evidence: Path) -> float:
    """Return the number at STUDY.path.to.number; LookupError says what is missing."""
    study, *keys = path.split(".")
    file = evidence / f"{study}.json"
    if not file.is_file():
        raise LookupError(f"no {file.name} in docs/evidence")
    report = json.loads(file.read_text(encoding="utf-8"))
    node: Any = {**report, **report["results"]}
    for key in keys:
        if not isinstance(node, dict) or key not in node:
            raise LookupError(f"{file.name} has no '{key}' there")
        node = node[key]
    if isinstance(node, bool) or not isinstance(node, int | float):
        raise LookupError(f"{file.name} has no number there")
    return node


def rounded(value: float, shown: str) -> str:
    """Return a number with the digits, and in the notation, of one that is shown."""
    match = NUMBER.fullmatch(shown)
    assert match is not None, shown
    digits = max(1, len(match[1].replace(".", "").lstrip("0")))
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    if float(f"{mantissa}e{exponent}") == float(shown):
        return shown
    if match[2]:
        return f"{mantissa}e{int(exponent)}"
    if isinstance(value, int) and "." not in match[1]:
        return str(value)
    return f"{Decimal(f'{mantissa}e{exponent}'):f}"


def paths(marker: str) -> list[str]:
    """Return the items of a marker in order, each a whole path or UNMEASURED."""
    first, *lines = re.sub(r"\n[ \t]+", " ", marker.strip()).splitlines()
    head, colon, rest = first.partition(":")
    if not colon and len(first.split()) > 1:
        head, rest = "", first
    found = []
    for line in [rest, *lines]:
        prefix, _, items = line.rpartition(":")
        prefix, _, values = prefix.partition("{")
        parts = [part for part in (head.strip(), prefix.strip()) if part]
        for value in values.rstrip(" }").split() or [""]:
            for item in items.split():
                below, path = ("<", item[1:]) if item.startswith("<") else ("", item)
                whole = ".".join([*parts, path]).replace("{}", value)
                found.append(item if item == UNMEASURED else below + whole)
    return found


def numbers(block: str) -> Iterator[re.Match[str]]:
    """Yield the numbers of a paragraph, a list or a table."""
    text = NO_TEXT.sub(lambda match: " " * len(match[0]), block)
    if text.lstrip().startswith("|"):
        rows = text.splitlines(keepends=True)
        for i, row in enumerate(rows):
            label = row.find("|", row.find("|") + 1)
            rows[i] = " " * len(row) if i < 2 else " " * label + row[label:]
        text = "".join(rows)
    return NUMBER.finditer(text)


def marked(text: str) -> Iterator[tuple[int, list[Shown] | str]]:
    """Yield the line of each marker, and the numbers of its block or what is wrong with it."""
    for marker in MARKER.finditer(text):
        line = text.count("\n", 0, marker.start()) + 1
        block = text[marker.end() :].split("\n\n", 1)[0].split("<!--", 1)[0]
        found, items = list(numbers(block)), paths(marker[1]) if marker[1].strip() else []
        if len(found) != len(items):
            shown = ", ".join(match[0] for match in found) or "none"
            yield line, f"{len(items)} items for {len(found)} numbers: {shown}"
        else:
            yield line, [Shown(marker.end() + m.start(), m[0], p) for m, p in zip(found, items, strict=True)]


def faults(text: str, source: str, evidence: Path) -> list[str]:
    """Return every fault of a page's marked numbers, with file and line."""
    found = []
    for line, block in marked(text):
        if isinstance(block, str):
            found.append(f"{source}:{line}: {block}")
            continue
        for number in block:
            if number.path == UNMEASURED:
                continue
            path = number.path.removeprefix("<")
            where = f"{source}:{text.count(chr(10), 0, number.start) + 1}: {path}"
            try:
                value = look_up(path, evidence)
            except LookupError as error:
                found.append(f"{where}: {error.args[0]}")
                continue
            if path != number.path:
                if not abs(value) < float(number.text):
                    found.append(f"{where}: shows < {number.text}, measured {value!r}")
            elif float(rounded(value, number.text)) != float(number.text):
                found.append(f"{where}: shows {number.text}, measured {value!r}")
    if len(TAG.findall(text)) != len(MARKER.findall(text)):
        found.append(f"{source}: a marker is not closed")
    return found


def rewritten(text: str, evidence: Path) -> str:
    """Return a page with the numbers that are measured now; those without a measurement stay."""
    for _, block in list(marked(text))[::-1]:
        for start, shown, path in [] if isinstance(block, str) else block[::-1]:
            with contextlib.suppress(LookupError):
                if path != UNMEASURED and not path.startswith("<"):
                    text = text[:start] + rounded(look_up(path, evidence), shown) + text[start + len(shown) :]
    return text


def differences(root: Path) -> list[str]:
    """Return every fault of the marked numbers of all pages."""
    found = []
    for page in pages(root):
        found += faults(page.read_text(encoding="utf-8"), str(page.relative_to(root)), root / "docs" / "evidence")
    return found


def main(arguments: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """Print what differs, or write what is measured into the pages; return the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given not in ([], ["--write"]):
        print("usage: python -m evidence.docs [--write]", file=sys.stderr)
        return 2
    for page in pages(root) if given else []:
        text = page.read_text(encoding="utf-8")
        new = rewritten(text, root / "docs" / "evidence")
        if new != text:
            page.write_text(new, encoding="utf-8")
    problems = differences(root)
    print("\n".join(problems) or "every marked number is the measured one")
    return 1 if problems else 0


if __name__ == "__main__":
    raise SystemExit(main())
