"""The ``qrsim`` command: finds the subcommand, hands it its options, and turns errors into messages and exit codes.

A subcommand is a dataclass whose fields are its options and whose ``run`` does the work and returns an exit code
(None: 0). Its docstring is its help: the first line stands in the list of commands, an Example section at the end.
To add one, import it here and add it to COMMANDS. Modules of commands import what is slow inside ``run``, so that
the help stays quick.

Exit codes: 0 fine, 1 the run failed, 2 wrong usage, 130 interrupted (Ctrl-C), 141 the reader of the output went away,
143 terminated (SIGTERM).
"""

from __future__ import annotations

import errno
import inspect
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, make_dataclass
from typing import Annotated, Any, Protocol, Union

import qrsim.starting  # noqa: F401 (before the others)

# isort: split
import tyro

from qrsim.apps.autopilot.command import Ardupilot, Betaflight
from qrsim.apps.autopilot.px4 import Px4
from qrsim.apps.brief import Brief
from qrsim.apps.cache import Clear, Info, Pack, Unpack
from qrsim.apps.check.command import Check
from qrsim.apps.compare import Compare
from qrsim.apps.complaints import in_a_sentence
from qrsim.apps.data import Fetch, Where
from qrsim.apps.discover import Discover
from qrsim.apps.export import Export
from qrsim.apps.identify import Identify
from qrsim.apps.mavlink import Mavlink
from qrsim.apps.openloop.command import OpenLoop
from qrsim.apps.plot import Plot
from qrsim.apps.replay import Replay
from qrsim.apps.ros2 import Ros2
from qrsim.apps.run.command import Run
from qrsim.apps.scenario import List, Schema, Show
from qrsim.apps.score import Score
from qrsim.apps.serve import Serve
from qrsim.apps.slam import SlamCommand
from qrsim.apps.sweep import Sweep
from qrsim.apps.sweep_report import SweepReport
from qrsim.apps.train import Train
from qrsim.apps.validate import Validate
from qrsim.apps.view import View
from qrsim.errors import QrsimError, UsageError, did_you_mean, shortened, visible
from qrsim.files import interruptions
from qrsim.view.flight import completed

DESCRIPTION = """A simulator of several unmanned aerial vehicles outdoors.

Example:
  qrsim run
  qrsim run outdoor_patrol --seed 7 --set world.wind.speed_20ft=7
  qrsim plot runs/NAME"""

# What the system says of a name before it looks whether there is such a file.
_NAMES = (errno.ENAMETOOLONG, errno.ELOOP)
_TYRO_CONFIG = (tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff)


class Command(Protocol):
    """A subcommand."""

    def run(self) -> int | None:
        """Do the command's work; return the exit code, None for 0."""


@dataclass(frozen=True)
class Group:
    """Subcommands under a common name (``qrsim data fetch``)."""

    description: str
    commands: Mapping[str, type[Command]]


@dataclass(frozen=True)
class Version:
    """Print the versions of qrsim, Python and the libraries that numbers depend on (for bug reports).

    Example:
      qrsim version
    """

    def run(self) -> None:
        """Print the versions of qrsim, Python, JAX, jaxlib and NumPy, and the platform, one in a line."""
        import platform
        from importlib.metadata import version

        rows = {"qrsim": version("qrsim"), "python": platform.python_version()}
        rows |= {name: version(name) for name in ("jax", "jaxlib", "numpy")}
        rows["platform"] = platform.platform()
        for name, text in rows.items():
            print(f"{name:<9} {text}")


DATA = Group(
    """Fetch the public recordings that validation and tests use, or print their folder.

Example:
  qrsim data fetch
  qrsim data where""",
    {"fetch": Fetch, "where": Where},
)

CACHE = Group(
    """Show, empty or carry the cache of compiled programs.

Example:
  qrsim cache info
  qrsim cache pack programs.tar.gz""",
    {"info": Info, "clear": Clear, "pack": Pack, "unpack": Unpack},
)

AUTOPILOT = Group(
    """Fly vehicles by the firmware of an autopilot.

Example:
  qrsim autopilot betaflight""",
    {"betaflight": Betaflight, "ardupilot": Ardupilot, "px4": Px4},
)

COMMANDS: dict[str, type[Command] | Group] = {
    "run": Run,
    "check": Check,
    "brief": Brief,
    "list": List,
    "show": Show,
    "schema": Schema,
    "plot": Plot,
    "view": View,
    "compare": Compare,
    "export": Export,
    "openloop": OpenLoop,
    "validate": Validate,
    "identify": Identify,
    "discover": Discover,
    "score": Score,
    "train": Train,
    "serve": Serve,
    "mavlink": Mavlink,
    "ros2": Ros2,
    "autopilot": AUTOPILOT,
    "replay": Replay,
    "slam": SlamCommand,
    "sweep": Sweep,
    "sweep-report": SweepReport,
    "data": DATA,
    "cache": CACHE,
    "version": Version,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line ``argv`` (default: that of the process) and return the exit code; never raises an error."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if sys.stdout is None:  # the caller closed it
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 (it stays open until the process ends)
    _plain_warnings()
    try:
        with interruptions.heard():
            code = _dispatch(arguments)
            sys.stdout.flush()
    except QrsimError as error:
        _print_error(str(error))
        return error.exit_code
    except KeyboardInterrupt as error:
        return _interrupted(error)
    except BrokenPipeError:
        _discard_output()
        return 141
    except Exception as error:
        if received := interruptions.received():  # a library has made another exception of it
            return _interrupted(received)
        if isinstance(error, OSError) and error.errno in _NAMES and isinstance(error.filename, str):
            _print_error(f"{visible(shortened(error.filename, 100))}: {error.strerror}")
            return 2
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
            _discard_output()
            _print_error(f"cannot write the output: {error.strerror}")
            return 1
        import traceback

        traceback.print_exc()
        _print_error("this is a bug in qrsim: please report it with the lines above and the output of 'qrsim version'")
        return 1
    return code


def _interrupted(error: BaseException) -> int:
    """Print why the program was stopped ("interrupted" or "terminated"), and return its exit code."""
    print(interruptions.word(error), file=sys.stderr)
    return interruptions.exit_code(error)


def _plain_warnings() -> None:
    """Make Python show warnings in one line, without the source line that gave them."""
    import warnings

    def show(message: Warning | str, *_: object, **__: object) -> None:
        """Print a warning in one line on standard error."""
        print(f"warning: {_visible_lines(str(message))}", file=sys.stderr)

    warnings.showwarning = show


def _dispatch(arguments: list[str]) -> int:
    """Run the command that the arguments name, and return its exit code."""
    if arguments[:1] == ["--version"]:
        from importlib.metadata import version

        print(f"qrsim {version('qrsim')}")
        return 0
    for argument in arguments:
        # Python keeps bytes that are no text of the terminal's encoding; logs and JSON could not hold them.
        if "\0" in argument or any("\ud800" <= character <= "\udfff" for character in argument):
            raise UsageError(f"qrsim: the argument {argument!a} is no text in UTF-8")
    try:
        command = _parse(arguments, COMMANDS, "qrsim", DESCRIPTION)
    except SystemExit as leaving:  # tyro has printed its help
        return leaving.code if isinstance(leaving.code, int) else 2
    return command.run() or 0


def _parse(
    arguments: list[str], commands: Mapping[str, type[Command] | Group], program: str, description: str
) -> Command:
    """Parse the arguments to one of ``commands`` with its options; raises SystemExit once tyro has printed something,
    such as help."""
    name = arguments[0] if arguments else ""
    entry = commands.get(name)
    if isinstance(entry, Group):
        return _parse(arguments[1:], entry.commands, f"{program} {name}", entry.description)
    if entry is not None:
        return _filled_in(entry, f"{program} {name}", arguments[1:])
    if name and not name.startswith("-"):
        raise UsageError(f"{program}: no such command '{name}'{did_you_mean(name, commands)}")
    if not arguments:
        raise UsageError(f"{program}: expected a command: {', '.join(commands)} ('{program} --help' describes them)")
    if len(commands) == 1:
        description = _with_the_only(commands, description)

    def parse() -> Any:
        """Parse the arguments with all commands as choices."""
        return tyro.cli(_menu(commands), prog=program, description=description, args=arguments, config=_TYRO_CONFIG)

    with in_a_sentence(program, ("--help",), parse):
        return parse()


def _filled_in(entry: type[Command], program: str, arguments: list[str]) -> Command:
    """Return a command of the class ``entry`` with its options filled in from the arguments."""
    given = completed(arguments) if entry is Run else arguments
    options = list(_options(entry))

    def parse() -> Command:
        """Parse the arguments as options of the one command."""
        description = _help_text(inspect.getdoc(entry) or "")
        return tyro.cli(entry, prog=program, description=description, args=given, config=_TYRO_CONFIG)

    with in_a_sentence(program, options, parse):
        return parse()


def _options(entry: Any) -> Iterator[str]:
    """Yield the names of a command's options, those of its nested groups of options too."""
    for each in fields(entry):
        if is_dataclass(each.default_factory):
            yield from _options(each.default_factory)
        elif "Positional" not in str(each.type):
            yield f"--{each.name.replace('_', '-')}"


def _with_the_only(commands: Mapping[str, type[Command] | Group], description: str) -> str:
    """Return a description with the only command of a group added, since tyro does not list a single choice."""
    ((name, entry),) = commands.items()
    text = entry.description if isinstance(entry, Group) else inspect.getdoc(entry) or ""
    return f"{description}\n\nCommand:\n  {name}  {text.partition(chr(10))[0]}"


def _help_text(docstring: str) -> str:
    """Lay out a docstring as help text for the terminal, because tyro drops Example sections, joins lines and does not
    wrap."""
    import shutil
    import textwrap

    width = min(shutil.get_terminal_size().columns, 100)
    first, *others = docstring.split("\n\n")
    text = first
    for paragraph in others:
        if "\n  " in paragraph:
            text += f"\n\n{paragraph}"
        else:  # tyro leaves a line alone that begins with a space, and adds an empty line where there was one
            text += "\n" + textwrap.fill(paragraph, width, initial_indent="  ", subsequent_indent="  ")
    return text


def _menu(commands: Mapping[str, type[Command] | Group]) -> Any:
    """Return a union type from which tyro makes help that lists the commands, each with its first line."""
    choices: list[object] = []
    for name, entry in commands.items():
        text = entry.description if isinstance(entry, Group) else inspect.getdoc(entry) or ""
        placeholder = make_dataclass(name, [])
        choices.append(Annotated[placeholder, tyro.conf.subcommand(name, description=text.partition("\n")[0])])
    return Union[tuple(choices)]  # noqa: UP007 (built from a list)


def _print_error(message: str) -> None:
    """Print an error message on standard error, in colour on a terminal."""
    from rich.console import Console
    from rich.text import Text

    text = Text.assemble(("error: ", "bold red"), _visible_lines(message))
    Console(stderr=True, soft_wrap=True, highlight=False).print(text)


def _visible_lines(text: str) -> str:
    """Return a text with the control characters of each line written as escapes, so that it is safe to print."""
    return "\n".join(map(visible, text.split("\n")))


def _discard_output() -> None:
    """Redirect standard output to the null device, so that flushing it at exit raises no second error."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):  # standard output has no descriptor (it was replaced, as in tests)
        return


if __name__ == "__main__":
    sys.exit(main())
