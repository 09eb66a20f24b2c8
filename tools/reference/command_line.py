"""The page of the command line: every command with its options, from the parsers of tyro."""

from __future__ import annotations

import inspect
import re
import warnings
from collections.abc import Iterator, Mapping
from typing import Any

from qrsim import cli
from tools.reference.tables import code, page, sentence, table

HEAD = ("option", "value", "default", "meaning")
_DEFAULT = re.compile(r"\s*\((?:default: (?P<default>.*)|(?P<word>required|repeatable|optional))\)$", re.DOTALL)
CODES = (
    ("0", "The command succeeded."),
    ("1", "The run failed: a disk is full, data is missing, a log does not show the requested constants."),
    ("2", "Wrong usage: an unknown name, a value out of its range, faults in a scenario."),
    ("3", "A verdict of `qrsim brief`: marginal. Its no-go is 1."),
    ("130", "Interrupted by Ctrl-C; a run folder stays readable."),
    ("141", "The reader of the output went away, as in `qrsim list | head -1`."),
    ("143", "Terminated by SIGTERM; a run folder stays readable."),
)


def pages() -> Mapping[str, str]:
    """Return the page."""
    commands = list(_commands(cli.COMMANDS, "qrsim"))
    introduction = """Every command of `qrsim` with its options. `qrsim COMMAND --help` prints the same in a
        terminal. Errors are one line on standard error that names what was wrong and what is allowed."""
    rows = [(f"[`{name}`](#{name.replace(' ', '-')})", _first(entry)) for name, entry in commands]
    codes = "## Exit codes\n\n" + table(("code", "meaning"), ((code(number), text) for number, text in CODES))
    parts = [_command(name, entry) for name, entry in commands]
    return {"command_line.md": page("Command line", introduction, table(("command", "purpose"), rows), codes, *parts)}


def _commands(commands: Mapping[str, Any], program: str) -> Iterator[tuple[str, Any]]:
    for name, entry in commands.items():
        if isinstance(entry, cli.Group):
            yield from _commands(entry.commands, f"{program} {name}")
        else:
            yield f"{program} {name}", entry


def _first(entry: Any) -> str:
    return (inspect.getdoc(entry) or "").partition("\n")[0]


def _command(name: str, entry: Any) -> str:
    """Return the part of the page about one command."""
    text, _, example = (inspect.getdoc(entry) or "").partition("\nExample:\n")
    paragraphs = [" ".join(paragraph.split()) for paragraph in text.strip().split("\n\n")]
    parts = [f"## {name}", *paragraphs]
    if example:
        parts.append("```text\n" + inspect.cleandoc(example) + "\n```")
    rows = [_row(action) for action in _parser(name, entry)._actions if "--help" not in action.option_strings]
    return "\n\n".join([*parts, table(HEAD, rows)] if rows else parts)


def _parser(name: str, entry: Any) -> Any:
    import tyro.extras

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return tyro.extras.get_parser(entry, prog=name, config=cli._TYRO_CONFIG)


def _row(action: Any) -> tuple[str, ...]:
    """Return option, value, default and meaning of one argument."""
    meaning = " ".join((action.help or "").split())
    found = _DEFAULT.search(meaning)
    default = (found["default"] or found["word"] or "") if found else ""
    meaning = meaning[: found.start()] if found else meaning
    metavar = action.metavar if isinstance(action.metavar, str) else ""
    flag = action.nargs == 0
    names = action.option_strings or [metavar or action.dest]
    value = "" if flag or not action.option_strings else metavar
    if flag and default == "False":
        default = ""
    return ", ".join(map(code, names)), code(value), default, sentence(meaning)
