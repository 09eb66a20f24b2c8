"""Output of ``qrsim compare``, as text and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from qrsim.errors import visible
from qrsim.files import Content
from qrsim.files.yaml_text import dump_line
from qrsim.runs import Event, Run
from qrsim.runs.compare import Comparison, Difference, EventComparison, InjectionComparison, Moment, StreamComparison
from qrsim.runs.headlines import headlines

MOST_SETTINGS, LONGEST_VALUE, MOST_INJECTIONS = 30, 60, 10
RUNS = "AB"


def print_report(first: Run, second: Run, found: Comparison) -> None:
    """Print the differences between two runs, then the verdict."""
    for letter, run in zip(RUNS, (first, second), strict=True):
        count = f"{len(run.vehicles)} vehicle{'s' if len(run.vehicles) > 1 else ''}"
        print(f"{letter}: {run.folder}  ({run.info.scenario}, seed {run.info.seed}, {count})")
    _print_settings(found)
    _print_headlines(first, second)
    print()
    _print_missing("vehicles", found.vehicles_only)
    _print_missing("streams", found.streams_only)
    for stream in found.streams:
        _print_stream(stream)
    if found.events:
        _print_events(found.events)
    _print_injections(found.injections)
    if found.differences:
        _print_differences(found.differences)
    print(f"\n{_verdict(found)}")


def _print_settings(found: Comparison) -> None:
    """Print a table of the settings that differ between two runs."""
    if not found.settings:
        print("\nSettings and scenario are the same.")
        return
    table = _table(("setting", "A", "B"), numbers=0)
    for setting in found.settings[:MOST_SETTINGS]:
        table.add_row(Text(setting.path), *(Text(_shortened_text(value)) for value in setting.values))
    _print_table(table)
    if len(found.settings) > MOST_SETTINGS:
        print(f"... and {len(found.settings) - MOST_SETTINGS} more settings, see --json")


def _print_headlines(first: Run, second: Run) -> None:
    """Print a table of both runs' headline numbers, such as tracking error, without those that both lack."""
    table = _table(("", "unit", *RUNS, "B - A"), numbers=3)
    for one, other in zip(headlines(first), headlines(second), strict=False):
        values = (one.value, other.value)
        known = [value for value in values if isinstance(value, str) or math.isfinite(value)]
        if known:
            words = [value if isinstance(value, str) else _format_number(value, 4) for value in values]
            a, b = values
            change = math.nan if isinstance(a, str) or isinstance(b, str) else b - a
            table.add_row(*map(Text, (one.name, one.unit, *words, _format_number(change, 4))))
    if table.row_count:
        print()
        _print_table(table)


def _shortened_text(value: object) -> str:
    """Return a value as text of at most LONGEST_VALUE characters."""
    text = str(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 3]}..."


def _print_missing(what: str, only: tuple[Sequence[str], Sequence[str]]) -> None:
    """Print the names (of what ``what`` says, such as streams) that only the first or only the second run has."""
    for letter, names in zip(RUNS, only, strict=True):
        if names:
            print(f"{what} only in {letter}: {', '.join(names)}")


def _print_stream(stream: StreamComparison) -> None:
    """Print how many ticks and quantities of a stream are equal in two runs."""
    total = stream.equal + len(stream.differences)
    ticks = [f"{count} only in {letter}" for letter, count in zip(RUNS, stream.ticks_only, strict=True) if count]
    parts = [", ".join([f"{stream.ticks} common ticks", *ticks]), f"{stream.equal} of {total} quantities equal"]
    print(f"{stream.stream}: {'; '.join(parts)}")
    _print_missing("  quantities", stream.columns_only)
    if stream.other_units:
        print(f"  not compared, because their units differ: {', '.join(stream.other_units)}")


def _print_events(events: EventComparison) -> None:
    """Print the number of equal events of two runs, and the first events that only one of them has."""
    only = [f"{len(own)} only in {letter}" for letter, own in zip(RUNS, events.only, strict=True) if own]
    print(f"events: {', '.join([f'{events.equal} equal', *only])}")
    for letter, own in zip(RUNS, events.only, strict=True):
        if own:
            print(f"  first only in {letter}: {_event_text(own[0])}")


def _print_injections(found: InjectionComparison) -> None:
    """Print the number of equal in-flight injections, and those that only one run has."""
    if found.equal or any(found.only):
        only = [f"{len(own)} only in {letter}" for letter, own in zip(RUNS, found.only, strict=True) if own]
        print(f"injections: {', '.join([f'{found.equal} equal', *only])}")
    for letter, own in zip(RUNS, found.only, strict=True):
        for entry in own[:MOST_INJECTIONS]:
            print(f"  only in {letter}: {visible(dump_line(entry))}")


def _event_text(event: Event) -> str:
    """Return the message of an event or, if it has none, its kind, vehicle and time."""
    return event.message or f"{event.kind} of {event.vehicle or 'the world'} at {event.time:.2f} s"


def _print_differences(found: Sequence[Difference]) -> None:
    """Print a table of the logged quantities that differ between two runs."""
    table = _table(("quantity", "unit", "vehicle", "first at [s]", "in A", "in B", "largest", "RMS"), numbers=5)
    for item in found:
        where = (item.quantity, item.unit, item.first.vehicle, f"{item.first.time:.10g}")
        numbers = (*_values(*item.first.values), _format_number(item.largest_difference), _format_number(item.rms))
        table.add_row(*map(Text, (*where, *numbers)))
    print()
    _print_table(table)
    unmatched = [f"{item.quantity} ({item.unmatched})" for item in found if item.unmatched]
    if unmatched:
        print(f"there in one run only, so not in largest and RMS (number of values): {', '.join(unmatched)}")


def _values(a: float, b: float) -> tuple[str, str]:
    """Format two different floats as texts with enough digits to tell them apart: 6, or all of their type."""
    digits = next((digits for digits in (6, 9) if _format_number(a, digits) != _format_number(b, digits)), 17)
    return _format_number(a, digits), _format_number(b, digits)


def _format_number(value: float, digits: int = 6) -> str:
    """Return a number as text, "-" for NaN."""
    return "-" if math.isnan(value) else f"{value:.{digits}g}"


def _table(headings: Sequence[str], numbers: int) -> Table:
    """Return an empty Rich table with these headings; its last ``numbers`` columns are right-aligned."""
    table = Table(box=SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
    for i, heading in enumerate(headings):
        right = i >= len(headings) - numbers
        # As Text, because in a plain string rich takes [s] for a style.
        table.add_column(Text(heading), justify="right" if right else "left", overflow="fold", no_wrap=right)
    return table


def _print_table(table: Table) -> None:
    """Print a Rich table, with wide rows broken in a terminal and whole in a file."""
    console = Console()
    # A terminal breaks the lines of what is wider, and no number is lost; a file has no width.
    console.width = max(console.width, 120) if console.is_terminal else 200
    with console.capture() as captured:  # printed here, because rich ends the process where the reader is gone
        console.print(table)
    print(captured.get(), end="")


def _verdict(found: Comparison) -> str:
    """Return the sentence that sums up the comparison of two runs."""
    if found.bit_identical:
        return "The logs are bit-identical."
    if found.same:
        closeness = f"within the tolerance of {found.tolerance:g}" if found.tolerance else "though not to the last bit"
        return f"The logs are the same, {closeness}."
    if found.differences:
        first = found.differences[0]
        return f"The logs differ, for the first time at {first.first.time:.10g} s in {first.quantity}."
    return "The logs record different quantities; all common values are equal."


def to_json(first: Run, second: Run, found: Comparison) -> Content:
    """Return the comparison of two runs as a dict for JSON; non-finite numbers are None."""
    events = found.events
    return {
        "runs": [str(first.folder), str(second.folder)],
        "same": found.same,
        "bit_identical": found.bit_identical,
        "tolerance": found.tolerance,
        "settings": [{"path": item.path, "values": _plain(list(item.values))} for item in found.settings],
        "summary": [
            {"name": one.name, "unit": one.unit, "values": _plain([one.value, other.value])}
            for one, other in zip(headlines(first), headlines(second), strict=False)
        ],
        "vehicles": list(found.vehicles),
        "vehicles_only": _plain(found.vehicles_only),
        "streams_only": _plain(found.streams_only),
        "streams": [_stream_json(stream) for stream in found.streams],
        "differences": [_difference_json(item) for item in found.differences],
        "injections": {"equal": found.injections.equal, "only": _plain(found.injections.only)},
        "events": events and {"equal": events.equal, "only": _plain([[asdict(e) for e in o] for o in events.only])},
    }


def _stream_json(stream: StreamComparison) -> Content:
    """Return the comparison of a stream as a dict for JSON."""
    return {
        "stream": stream.stream,
        "ticks": stream.ticks,
        "ticks_only": list(stream.ticks_only),
        "quantities_only": _plain(stream.columns_only),
        "other_units": list(stream.other_units),
        "equal": stream.equal,
        "different": len(stream.differences),
    }


def _difference_json(item: Difference) -> Content:
    """Return the statistics of a differing quantity as a dict for JSON."""

    def moment(at: Moment | None) -> Content | None:
        """Return time, vehicle and both values of a moment as a dict for JSON; None without a moment."""
        return None if at is None else {"time_s": at.time, "vehicle": at.vehicle, "values": _plain(list(at.values))}

    return {
        "quantity": item.quantity,
        "unit": item.unit,
        "first": moment(item.first),
        "largest": moment(item.largest),
        "largest_difference": _plain(item.largest_difference),
        "rms_difference": _plain(item.rms),
        "unmatched_values": item.unmatched,
    }


def _plain(value: object) -> object:
    """Convert a value for JSON: NaN and infinity to None, values of other types to text."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)
