"""Parts of a QGroundControl plan: what is there, of which kind, and numbers within their bounds."""

from __future__ import annotations

import bisect
import errno
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from qrsim.errors import ScenarioError, UsageError, did_you_mean_file, nearest
from qrsim.files import Content
from qrsim.files.user_files import LARGEST_TEXT, read_text
from qrsim.scenarios.local import swapped_hint

KINDS = {dict: "an object", list: "a list", bool: "true or false", int: "a whole number"}


LARGEST_LENGTH = 1e5
HOME = "[latitude, longitude, altitude]"


class PlanFaultError(Exception):
    """One fault: the path of a value, and what is wrong with it."""


def plan_content(source: str, expected: str = "a .plan of QGroundControl", most: int = LARGEST_TEXT) -> Any:
    """Return the JSON content of a plan file; raises UsageError if it is not JSON or over ``most`` bytes."""
    try:
        text = read_text(source, most)
    except OSError as error:
        if error.errno == errno.EILSEQ:
            raise UsageError(f"{source}: is not JSON: it is no UTF-8 text") from None
        raise UsageError(f"{source}: cannot be read: {error.strerror}{did_you_mean_file(Path(source))}") from None
    try:
        return json.loads(text, object_pairs_hook=_without_twins)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        if text.startswith("QGC WPL"):
            raise UsageError(
                f"{source}: is not JSON: {where}: {error.msg}; it begins as a QGC WPL file: call it .waypoints"
            ) from None
        raise UsageError(f"{source}: is not JSON: {where}: {error.msg}; expected {expected}") from None
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{source}: is no plan: {error}") from None
    except PlanFaultError as fault:
        raise ScenarioError(source, [str(fault)]) from None


def with_lines(source: str, problems: list[str]) -> list[str]:
    """Add to each problem, a text that begins with a value's path, the plan file's line of the enclosing object."""
    lines = lines_of(source, [problem.partition(": ")[0] for problem in problems])
    found = []
    for problem in problems:
        path, colon, words = problem.partition(": ")
        found.append(f"{path} (line {lines[path]}){colon}{words}" if path in lines else problem)
    return found


def lines_of(source: str, paths: list[str]) -> dict[str, int]:
    """Return path -> line of the file on which the innermost JSON object along the path begins, for paths with one."""
    decoder: Any = json.JSONDecoder()
    lines: dict[int, int] = {}
    kept: list[object] = []
    parse = decoder.parse_object

    def parse_object(text_and_begin: tuple[str, int], *args: object) -> tuple[Any, int]:
        """Parse one JSON object and note the offset at which its text begins."""
        found, end = parse(text_and_begin, *args)
        # Kept, because the number of an object that is gone may become another's.
        kept.append(found)
        lines[id(found)] = text_and_begin[1]
        return found, end

    decoder.parse_object = parse_object
    # Only the scanner in Python asks for objects through the decoder.
    decoder.scan_once = json.scanner.py_make_scanner(decoder)  # type: ignore[attr-defined]
    try:
        text = read_text(source)
        content = decoder.decode(text)
    except (OSError, ValueError, RecursionError):
        return {}
    # All on one line, as some tools write it: the path says more.
    if "\n" not in text.strip():
        return {}
    ends = [i for i, letter in enumerate(text) if letter == "\n"]
    begins = {path: _begin_of(path, content, lines) for path in paths}
    return {path: bisect.bisect_left(ends, begin) + 1 for path, begin in begins.items() if begin is not None}


def _begin_of(path: str, part: object, begins: Mapping[int, int]) -> int | None:
    """Return the text offset of the innermost JSON object along a dotted path; ``begins`` maps object id -> offset."""
    begin = None
    for key in path.split(" ")[0].split("."):
        if isinstance(part, list) and key.isdecimal() and int(key) < len(part):
            part = part[int(key)]
        elif isinstance(part, dict) and key in part:
            part = part[key]
        else:
            break
        begin = begins.get(id(part), begin)
    return begin


def _without_twins(pairs: list[tuple[str, object]]) -> Content:
    """Return the key-value pairs of a JSON object as a dict; raise PlanFaultError for a key that occurs twice."""
    found: Content = {}
    for key, value in pairs:
        if key in found:
            raise PlanFaultError(f"'{key}' is given twice in one object")
        found[key] = value
    return found


def check_kind(content: object) -> None:
    """Raise PlanFaultError unless the JSON content is a plan of QGroundControl."""
    if not isinstance(content, dict) or "fileType" not in content:
        raise PlanFaultError("is no plan; expected an object with fileType 'Plan'")
    if content["fileType"] != "Plan":
        raise PlanFaultError(f"fileType: is {shown(content['fileType'])}; supported: 'Plan'")
    check_version(content, 1, "")


def shown(value: object) -> str:
    """Format a JSON value for a message: shortened, and null as JSON writes it."""
    return "null" if value is None else f"{value!r:.60}"


def part_of(parent: Mapping[str, object], key: str, kind: type, where: str) -> Any:
    """Return ``parent[key]``; raises PlanFaultError, which names ``where``, if it is missing or not a ``kind``."""
    path = f"{where}.{key}" if where else key
    if key not in parent:
        near = nearest(key, parent)
        home = f"{HOME}, which QGroundControl saves once the launch position is set"
        expected = home if key == "plannedHomePosition" else KINDS[kind]
        raise PlanFaultError(f"{path}: is missing; expected {expected}{f'; found {near!r}' if near else ''}")
    return of_kind(parent[key], kind, path)


def of_kind(value: object, kind: type, where: str) -> Any:
    """Return a value unchanged; raises PlanFaultError, which names its path ``where``, unless it is a ``kind``."""
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise PlanFaultError(f"{where}: expected {KINDS[kind]}, found {shown(value)}")
    return value


def check_version(parent: Mapping[str, object], supported: int, where: str) -> None:
    """Raise PlanFaultError unless a JSON object's ``version`` is the supported one; ``where`` is its path."""
    found = part_of(parent, "version", int, where)
    if found != supported:
        path = f"{where}.version" if where else "version"
        raise PlanFaultError(f"{path}: version {found} is not supported; supported: {supported}")


def section_of(content: Mapping[str, object], key: str, version: int) -> Content:
    """Return the section ``key`` (such as "mission") of a plan file; raises PlanFaultError for another version."""
    section: Content = part_of(content, key, dict, "")
    check_version(section, version, key)
    return section


def number_of(value: object, where: str, limit: float, unit: str) -> float:
    """Convert a JSON value to float; raises PlanFaultError unless it is a number within +-``limit``."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        meaning = ", which means 'the current one'" if value is None else ""
        kind = f"a number [{unit}]" if unit else "a number"
        raise PlanFaultError(f"{where}: expected {kind}, found {shown(value)}{meaning}")
    # NaN fails this comparison too.
    if not -limit <= value <= limit:
        raise PlanFaultError(f"{where}: {shown(value)} is out of range; allowed: {-limit:g} to {limit:g} {unit}")
    return float(value)


def degrees_of(latitude: object, longitude: object, where: tuple[str, str]) -> tuple[float, float]:
    """Return latitude and longitude [deg]; raises PlanFaultError out of range; ``where`` holds the path of each."""
    try:
        return number_of(latitude, where[0], 90.0, "deg"), number_of(longitude, where[1], 180.0, "deg")
    except PlanFaultError as fault:
        raise PlanFaultError(f"{fault}{swapped_hint(latitude, longitude)}") from None


def place_of(values: Sequence[object], where: str, count: int) -> tuple[float, ...]:
    """Parse (latitude, longitude) [deg], with altitude [m] if ``count`` is 3; raises PlanFaultError if invalid."""
    if len(values) != count:
        words = "latitude, longitude, altitude" if count == 3 else "latitude, longitude"
        raise PlanFaultError(f"{where}: expected [{words}], found {len(values)} values")
    place = degrees_of(values[0], values[1], (f"{where}: latitude", f"{where}: longitude"))
    return (*place, *(number_of(value, f"{where}: altitude", LARGEST_LENGTH, "m") for value in values[2:]))
