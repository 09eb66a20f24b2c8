"""The page of errors and warnings, with messages that the code gives now."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from qrsim import errors
from qrsim.extras import MissingExtraError
from qrsim.scenarios.scenario import load_scenario
from tools.reference.command_line import CODES
from tools.reference.tables import code, page, table

# Class, what causes it, what to do, and a call that raises one.
RAISED: tuple[tuple[type[errors.QrsimError], str, str, Callable[[], Any] | None], ...] = (
    (
        errors.UsageError,
        "A name, a value, a shape or the content of a file is wrong.",
        "Read the end of the message: it states what is allowed, or the nearest right name.",
        lambda: load_scenario("hoover"),
    ),
    (
        errors.ScenarioError,
        "A scenario has faults; the message has a line for each, with its path.",
        "Correct the keys that are named; [the keys of a scenario](scenario_schema.md) lists them all.",
        lambda: load_scenario("hover", ["world.wind.sped_20ft=7", "duration=-1"]),
    ),
    (
        MissingExtraError,
        "A feature needs packages that are not installed.",
        "Run the line that the message ends with.",
        None,
    ),
    (
        errors.LogError,
        "A flight log is damaged, or does not show the requested constants.",
        "Read `details`; record a log that excites the requested constants.",
        None,
    ),
    (
        errors.RunError,
        "A valid run could not be carried out: a full disk, missing data, a policy that failed.",
        "Mend the cause that is named and run again; what was logged stays readable.",
        None,
    ),
    (
        errors.BusyError,
        "Two threads used a simulation at once.",
        "Give each thread its own simulation, or guard it with a lock.",
        None,
    ),
)
WARNED: tuple[tuple[type[Warning], str], ...] = (
    (errors.NeighbourWarning, "Raise the size of the neighbour list that the message names."),
    (errors.RadioWarning, "Raise `world.radio.inbox.candidates`."),
    (errors.CompilerWarning, "Nothing needs to be done; results agree within rounding. Please report the message."),
)


def pages() -> Mapping[str, str]:
    """Return the page."""
    introduction = """Errors that you can cause derive from `qrsim.errors.QrsimError`. Their messages are one line
        for each fault: what is wrong, where, and what is allowed. The command line prints them without a traceback
        and ends with the exit code below."""
    rows = [
        (code(kind.__name__), str(kind.exit_code), _bases(kind), cause, remedy) for kind, cause, remedy, _ in RAISED
    ]
    examples = [f"`{kind.__name__}`:\n\n```text\n{_message(cause)}\n```" for kind, _, _, cause in RAISED if cause]
    warned = [(code(kind.__name__), (inspect.getdoc(kind) or "").partition("\n")[0], remedy) for kind, remedy in WARNED]
    return {
        "errors.md": page(
            "Errors", introduction,
            "## Exceptions", table(("class", "exit code", "also a", "cause", "remedy"), rows),
            "## Examples", *examples,
            "## Warnings", "Warnings go through `warnings.warn`; the command line prints each as one line.",
            table(("class", "meaning", "remedy"), warned),
            "## Exit codes", table(("code", "meaning"), ((code(number), text) for number, text in CODES)),
        )
    }  # fmt: skip


def _bases(kind: type) -> str:
    """Return the built-in exception that a class can be caught as."""
    return ", ".join(code(base.__name__) for base in (ValueError, RuntimeError) if issubclass(kind, base))


def _message(cause: Callable[[], Any]) -> str:
    try:
        cause()
    except errors.QrsimError as error:
        return str(error)
    raise AssertionError("the example of an error raised none")
