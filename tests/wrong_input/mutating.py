"""Mutations of text and bytes, for the fuzz of everything that a user can hand in."""

from __future__ import annotations

import re
import time
from collections.abc import Callable

import numpy as np

Rng = np.random.Generator
# What mutating has taken in this process, which is no part of what is measured.
SPENT_S = [0.0]
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
TOKEN = re.compile(r"\"[^\"\n]*\"|'[^'\n]*'|[\w.+/-]+")
NUMBERS = (
    "0", "-0.0", "-1", "1", "0.5", "2", "3.5", "10", "100", "1000", "12345", "1e-9", "-1e-300", "1e9", "1e15",
    "1e38", "1e39", "1e300", "-1e308", "1e999", "2147483647", "2147483648", "-2147483649", "9223372036854775807",
    "18446744073709551616", ".inf", "-.inf", ".nan", "NaN", "Infinity", "1e-45", "5e-324", "0x7fffffff", "0o777",
    "045", "1:30", "1_000", "1e1e1", "9" * 40, "9" * 400, "9" * 5000, "0." + "3" * 3000, "1000000000", "4096",
    "65536", "-90", "180", "360", "90.0000001",
)  # fmt: skip
VALUES = (
    "null", "~", "true", "false", "yes", "no", "on", "[]", "{}", "\"\"", "''", "[[1]]", "{a: 1}", "[1, 2, 3]",
    "[1, 2]", "[null, 1, 2]", "[true]", "abc", "2001-99-99", "2026-06-21", "2026-06-21T10:00:00Z", "!!int abc",
    "!!float x", "!!binary x", "!!python/object:os.system x", "!!set {a}", "!x y", "*a", "&a [*a]", "&a x", "<<",
    "{type: calm}", "{type: [1]}", "{type: {a: 1}}", "{type: null}", "{type: 1}", "{file: /dev/zero}",
    "{file: /dev/null}", "{file: /}", "{file: .}", "/dev/zero", "/dev/stdin", "/", "..", "PIPE", "\"a\\0b\"",
    "~nobody", "hover", "outdoor_patrol", "-", "?", ":", "|", ">", "%", "@", "`", "a: b: c", "'", "\"", "[", "]",
    "{", "}", ",", "# x", "---", "...", "! 5", "type", "name", "file", "vehicles", "\u00e9", "\u202e", "\U0001f681",
    "\u2028", "\ufeff", "\ufffd", "\u0661\u0662",
)  # fmt: skip
INSERTED = (
    "\0", "\x07", "\x1b[31m", "\t", "\r", "\n", "\r\n", "\ufeff", "\u2028", "\x85", "\x7f", "\u200b", "\ud7ff", " ",
    "  ", "'", '"', "[", "]", "{", "}", ":", ",", "-", "&a ", "*a", "!!str ", "|", ">", "#", "%YAML 1.1\n---\n",
    "<!DOCTYPE a [<!ENTITY x 'y'>]>", "&x;", "<a>", "</a>", "<![CDATA[", "e", ".", "0",
)  # fmt: skip


def pick(rng: Rng, choices: tuple[str, ...]) -> str:
    """Return one of some texts."""
    return choices[int(rng.integers(len(choices)))]


def _replaced(rng: Rng, text: str, pattern: re.Pattern[str], new: Callable[[str], str]) -> str:
    """Replace one match of a pattern."""
    found = list(pattern.finditer(text))
    if not found:
        return text
    match = found[int(rng.integers(len(found)))]
    return text[: match.start()] + new(match[0]) + text[match.end() :]


def number(rng: Rng, text: str) -> str:
    """Make a number extreme."""
    return _replaced(rng, text, NUMBER, lambda _: pick(rng, NUMBERS))


def scaled(rng: Rng, text: str) -> str:
    """Scale a number by something between a thousandth and a thousand."""

    def new(old: str) -> str:
        try:
            return repr(float(old) * float(10 ** rng.uniform(-3, 3)) * (-1 if rng.random() < 0.2 else 1))
        except (ValueError, OverflowError):
            return "1"

    return _replaced(rng, text, NUMBER, new)


def value(rng: Rng, text: str) -> str:
    """Put a value of another kind in the place of a token."""
    return _replaced(rng, text, TOKEN, lambda _: pick(rng, VALUES))


def swap(rng: Rng, text: str) -> str:
    """Put another token of the text in the place of one."""
    others = TOKEN.findall(text) or [""]
    return _replaced(rng, text, TOKEN, lambda _: str(others[int(rng.integers(len(others)))]))


def misspell(rng: Rng, text: str) -> str:
    """Leave a letter out of a token."""

    def new(old: str) -> str:
        i = int(rng.integers(len(old)))
        return old[:i] + old[i + 1 :]

    return _replaced(rng, text, TOKEN, new)


def line_twice(rng: Rng, text: str) -> str:
    """Give some lines twice, here or elsewhere: keys twice, blocks out of place."""
    lines = text.split("\n")
    i, j = sorted(int(k) for k in rng.integers(len(lines) + 1, size=2))
    at = int(rng.integers(len(lines) + 1)) if rng.random() < 0.5 else j
    return "\n".join(lines[:at] + lines[i:j][:200] + lines[at:])


def line_lost(rng: Rng, text: str) -> str:
    """Leave some lines out."""
    lines = text.split("\n")
    i = int(rng.integers(len(lines)))
    return "\n".join(lines[:i] + lines[i + 1 + int(rng.integers(3)) :])


def indented(rng: Rng, text: str) -> str:
    """Move a line to the right or to the left."""
    lines = text.split("\n")
    i = int(rng.integers(len(lines)))
    lines[i] = "  " + lines[i] if rng.random() < 0.5 else lines[i][2:]
    return "\n".join(lines)


def deep(rng: Rng, text: str) -> str:
    """Nest brackets deeply in the place of a token."""
    depth = int(rng.choice([5, 40, 200, 2000, 20_000]))
    opening, closing = (("[", "]"), ("{a: ", "}"), ("- ", ""), ('{"a":', "}"), ("<a>", "</a>"), ("(", ")"))[
        int(rng.integers(6))
    ]
    return _replaced(rng, text, TOKEN, lambda old: opening * depth + old + closing * depth)


def laughs(rng: Rng, text: str) -> str:
    """Add anchors that multiply."""
    levels = int(rng.integers(2, 12))
    rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels)]
    return "\n".join([*rows, text]) if rng.random() < 0.5 else _replaced(rng, text, TOKEN, lambda _: "&s {b: [*s, *s]}")


def long(rng: Rng, text: str) -> str:
    """Put something very long in the place of a token."""
    size = int(rng.choice([100, 5000, 300_000]))
    what = ("x", "1", "a.", "[1],", "é", " ", "\n", "- 1\n", "x: 1\n", "0,0,0 ")[int(rng.integers(10))]
    return _replaced(rng, text, TOKEN, lambda _: what * size)


def inserted(rng: Rng, text: str) -> str:
    """Insert a character that means something, or that no text has."""
    i = int(rng.integers(len(text) + 1))
    return text[:i] + pick(rng, INSERTED) * int(rng.choice([1, 1, 2, 50])) + text[i:]


def cut(rng: Rng, text: str) -> str:
    """End the text early."""
    return text[: int(rng.integers(len(text) + 1))]


def windows(rng: Rng, text: str) -> str:
    """Write it as other systems would."""
    return "\ufeff" * int(rng.integers(2)) + text.replace("\n", pick(rng, ("\r\n", "\r", "\n\n", "\u2028")))


TEXT = (
    number, number, number, scaled, scaled, value, value, value, swap, swap, misspell, line_twice, line_lost, indented,
    deep, laughs, long, inserted, inserted, cut, windows,
)  # fmt: skip


def mutated_bytes(rng: Rng, data: bytes) -> bytes:
    """Flip, lose, repeat, overwrite or cut some bytes."""
    found = bytearray(data)
    at, size = int(rng.integers(len(found) + 1)), int(rng.choice([1, 2, 4, 8, 64, 1000]))
    kind = int(rng.integers(8))
    if kind <= 2 and found:
        for place in rng.integers(len(found), size=int(rng.choice([1, 1, 3, 30]))):
            found[place] ^= 1 << int(rng.integers(8))
    elif kind == 3:
        del found[at : at + size]
    elif kind == 4:
        found[at:at] = found[at : at + size]
    elif kind == 5:
        found[at : at + size] = bytes([int(rng.choice([0, 255, 127, 128]))]) * size
    elif kind == 6:
        found[at:] = b""
    else:
        found[at : at + size] = rng.bytes(size)
    return bytes(found)


def mutated(rng: Rng, data: bytes, binary: bool = False) -> bytes:
    """Return some bytes with one to three mutations; of text mostly mutations that know what text is."""
    began = time.process_time()
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        if binary or rng.random() < 0.1:
            data = mutated_bytes(rng, data)
            continue
        text = TEXT[int(rng.integers(len(TEXT)))](rng, data.decode("utf-8", "replace"))
        data = text.encode("utf-8", "replace")
    if not binary and rng.random() < 0.01:
        data = data.decode("utf-8", "replace").encode("utf-16")
    SPENT_S[0] += time.process_time() - began
    return data
