"""The parser's complaints about a command line, which it prints in boxes, as one sentence each."""

from __future__ import annotations

import contextlib
import io
import os
import re
from collections.abc import Callable, Iterator, Sequence

from qrsim.errors import UsageError, did_you_mean, shortened

# Python's words for what is no number, and what was expected.
_NO_NUMBERS = (
    (r"invalid literal for int\(\) with base 10: (.*)", "a whole number"),
    (r"could not convert string to float: (.*)", "a number"),
)
# A terminal so wide that no line is broken.
_WIDE = "100000"


@contextlib.contextmanager
def in_a_sentence(program: str, options: Sequence[str], again: Callable[[], object]) -> Iterator[None]:
    """In the context, turn the command-line parser's error box and exit into a one-sentence UsageError; ``again``
    parses once more.

    Args:
        program: what is parsed for, such as "qrsim run".
        options: those that there are, such as "--seed".
        again: parses once more, to have the box in lines that are not broken.
    """
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            yield
    except SystemExit as leaving:
        if leaving.code != 2:
            raise
        raise UsageError(f"{program}: {sentence(_box(again), options)} (see '{program} --help')") from None


def _box(parse: Callable[[], object]) -> str:
    """Return the text that the command-line parser (tyro) prints on standard error while it parses, lines joined."""
    columns, said = os.environ.get("COLUMNS"), io.StringIO()
    os.environ["COLUMNS"] = _WIDE
    try:
        with contextlib.redirect_stderr(said), contextlib.suppress(SystemExit):
            parse()
    finally:
        if columns is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = columns
    return said.getvalue()


def sentence(box: str, options: Sequence[str]) -> str:
    """Convert the command-line parser's error box to one sentence, without frame, help and Python terms."""
    lines = list(filter(None, (line.strip("│ \t") for line in box.splitlines())))
    # The frame has the title; where characters are ASCII the title is underlined and there is no frame.
    begin = 2 if len(lines) > 1 and set(lines[1]) == {"-"} else int(box.startswith("╭"))
    inside = [line for line in lines[begin:] if line[0] != "╰"]
    rules = [number for number, line in enumerate(inside) if set(line) <= {"─", "-"}]
    words = " ".join(" ".join(inside[: rules[0] if rules else None]).split())
    if found := re.fullmatch(r"Error parsing (\S+): (.*)", words):
        return _no_value(*found.groups())
    if found := re.fullmatch(r"Unrecognized options: (.*)", words):
        return _unknown(found[1].split(", ")[0], options)
    if found := re.match(r"Missing value for argument '(.*?)'", words):
        return f"{found[1]}: its value is missing"
    if found := re.fullmatch(r"Missing from .*?: (--\S+ \S+|\S+) (.*?)\.?(?: \(required\).*)?", words):
        return f"{found[1]} is missing: {found[2]}"
    if found := re.fullmatch(r"invalid choice '(.*)' for argument '(\S+)'. Expected one of \((.*)\)\.", words):
        value, option, choices = found.groups()
        known = re.findall(r"'([^']*)'", choices)
        hint = did_you_mean(value, known)
        return f"{option} {shortened(value, 100)}: expected {', '.join(known)}{hint if 'mean' in hint else ''}"
    return shortened(words, 500)


def _no_value(option: str, words: str) -> str:
    """Return the error for a value that an option cannot take; ``words``: the parser's explanation."""
    for pattern, expected in _NO_NUMBERS:
        if found := re.fullmatch(pattern, words):
            return f"{option} {shortened(found[1], 100)}: expected {expected}"
    return f"{option}: {shortened(words, 500)}"


def _unknown(word: str, options: Sequence[str]) -> str:
    """Return the error for an unknown option, with the nearest known one, or for a word too many."""
    if word.startswith("-"):
        return f"no such option '{shortened(word, 100)}'{did_you_mean(word.partition('=')[0], options)}"
    return f"'{shortened(word, 100)}' is one word too many; a value with spaces goes in quotes"
