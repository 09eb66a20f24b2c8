"""Reads scenarios: files, built-in names, ``extends``, and ``--set`` overrides."""

from __future__ import annotations

import copy
import os
import re
from collections.abc import Container, Iterable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any

from qrsim.errors import LONGEST_NAME, ScenarioError, UsageError, did_you_mean, shortened
from qrsim.files import Content
from qrsim.files.recordings import RECORDINGS, data_folder
from qrsim.files.user_files import read_text
from qrsim.files.yaml_text import DEEPEST
from qrsim.files.yaml_text import dump_yaml as dump_yaml
from qrsim.files.yaml_text import parse_yaml as parse_yaml
from qrsim.scenarios.problems import component_types
from qrsim.scenarios.providing import anchor_code
from qrsim.scenarios.schema import ScenarioSpec

# Of content from Python: some 60 000 vehicles with waypoints of their own.
MOST_VALUES = 4_000_000


def built_in_names() -> list[str]:
    """Return the names of the built-in scenarios; those of a family are FAMILY/VARIANT."""
    folder = resources.files("qrsim.scenarios")
    alone = [item.name for item in folder.iterdir()]
    families = [item for item in folder.iterdir() if item.is_dir()]
    names = alone + [f"{family.name}/{item.name}" for family in families for item in family.iterdir()]
    return sorted(name.removesuffix(".yaml") for name in names if name.endswith(".yaml"))


def read_scenario(source: str | Path | Content) -> tuple[str, Content]:
    """Read a scenario from a built-in name, a YAML path or a dict; return (label of the source, content).

    What it extends is merged in, and every ``file:`` that a file names is absolute.
    """
    if not isinstance(source, str | os.PathLike | dict):
        raise UsageError(f"scenario: expected a name, the path of a .yaml file or a dict, found {source!r}")
    return _read(source if isinstance(source, dict) else str(source), [])


def _read(source: str | Content, children: list[tuple[str, str]]) -> tuple[str, Content]:
    """Read a scenario and merge it over what it extends; ``children`` are sources that extend it, to refuse loops."""
    identity, folder = _origin(source)
    name = "scenario" if isinstance(source, dict) else source
    if identity in (known for known, _ in children):
        chain = " -> ".join([*(called for _, called in children), name])
        raise ScenarioError(children[0][1], [f"extends: comes back to where it began: {chain}"])
    content = source if isinstance(source, dict) else _read_file(source, folder)
    if "extends" not in content:
        return name, content
    parent = content["extends"]
    if not isinstance(parent, str):
        raise ScenarioError(name, [f"extends: expected a built-in name or the path of a .yaml file, found {parent!r}"])
    if _is_file(parent):
        parent = str(folder / os.path.expanduser(parent))
    try:
        _, inherited = _read(parent, [*children, (identity, name)])
    except ScenarioError:
        raise
    except UsageError as error:
        raise ScenarioError(name, [f"extends: {error}"]) from None
    # What a scenario is called and said to be is its own.
    inherited = {key: value for key, value in inherited.items() if key not in ("name", "description")}
    own = {key: value for key, value in content.items() if key != "extends"}
    if not isinstance(source, dict):
        own.setdefault("name", Path(source).stem)
    return f"{name} (extends {parent})", merged(inherited, own)


def _origin(source: str | Content) -> tuple[str, Path]:
    """Return an identity of a scenario source, "" for a dict, and the folder that its relative paths start in."""
    if isinstance(source, dict):
        return "", Path.cwd()
    if source in built_in_names():
        return source, Path.cwd()
    # A null byte is no part of any file's name; reading it says so.
    return os.path.realpath(source.replace("\0", "")), Path(source).parent


def _is_file(name: str) -> bool:
    """Return whether the name of a scenario is the path of a file, by its suffix."""
    return Path(name).suffix in (".yaml", ".yml")


def _read_file(name: str, folder: Path) -> Content:
    """Read a built-in scenario or a YAML file; file names in it become absolute, relative ones start in ``folder``."""
    if name in built_in_names():
        text = resources.files("qrsim.scenarios").joinpath(*f"{name}.yaml".split("/")).read_text("utf-8")
        return _as_mapping(parse_yaml(text, name), name)
    path = Path(name)
    if (path / "run.json").is_file():
        raise UsageError(
            f"{path} is a run folder and no scenario: 'qrsim view {path}' shows the flight, and 'qrsim run "
            f"{path / 'scenario.yaml'}' flies its scenario again"
        )
    if not _is_file(name):
        hint = did_you_mean(name, built_in_names())
        raise UsageError(f"no scenario is called '{shortened(name, 200)}'{hint} (or give the path of a .yaml file)")
    try:
        text = read_text(path)
    except FileNotFoundError:
        near = [str(item) for item in path.parent.glob("*.y*ml")] if path.parent.is_dir() else []
        # Of the built-in ones that of its own name, before names that look like the whole of it.
        built_in = [path.stem] if path.stem in built_in_names() else built_in_names()
        hint = did_you_mean(name, [*near, *built_in])
        raise UsageError(f"scenario file {path}: no such file{hint if 'mean' in hint else ''}") from None
    except OSError as error:
        raise UsageError(f"scenario file {path}: cannot be read: {error.strerror}") from None
    content = _as_mapping(parse_yaml(text, name), name)
    if {"scenario", "vary"} <= content.keys():
        raise UsageError(f"{path} is a study and no scenario: 'qrsim sweep {path}' flies it")
    anchor_files(content, folder)
    anchor_code(content, folder)
    return content


def check_size(content: object, source: str) -> None:
    """Raise UsageError for content that is nested too deeply, too large, or contains itself.

    Raises:
        ScenarioError: it is.
    """
    count, level = 0, [content]
    for _ in range(DEEPEST + 1):
        count += len(level)
        if count > MOST_VALUES:
            raise ScenarioError(source, [f"more than {MOST_VALUES} values"])
        parts = (part.values() if isinstance(part, dict) else part for part in level if isinstance(part, dict | list))
        level = [entry for part in parts for entry in part]
        if not level:
            return
    raise ScenarioError(source, [f"nested deeper than {DEEPEST} levels"])


def checked_overrides(overrides: Iterable[str]) -> list[str]:
    """Return overrides as a list of texts; raises UsageError for other types, such as a single text."""
    if isinstance(overrides, str):
        raise UsageError(f"overrides: expected a list such as ['path=value'], found the text {overrides!r:.200}")
    try:
        found = None if isinstance(overrides, dict) else list(overrides)
    except TypeError:
        found = None
    if found is None:
        raise UsageError(f"overrides: expected a list such as ['path=value'], found {shortened(repr(overrides), 200)}")
    for override in found:
        if not isinstance(override, str):
            raise UsageError(f"overrides: expected texts such as 'path=value', found {override!r:.200}")
    return found


def merged(parent: Content, child: Content) -> Content:
    """Return scenario content ``parent`` updated recursively by ``child``; values of the child take precedence.

    A child of another ``type``, or a site from a ``plan``, replaces the parent wholly. A list replaces a list, an angle
    in one unit that in the other, a wind's ``speed`` its ``speed_20ft``, a site's ``height_amsl`` its ``height``, and
    null takes out what the parent has.
    """
    if ("type" in child and child["type"] != parent.get("type")) or "plan" in child:
        return copy.deepcopy(child)
    result = dict(parent)
    for key, value in child.items():
        # In Python a key can be anything, which the check of the whole finds.
        _drop_twin(result, str(key), kept=child)
        before = result.get(key)
        if value is None and key in parent:
            result.pop(key, None)
        elif isinstance(value, dict) and isinstance(before, dict):
            result[key] = merged(before, value)
        else:
            result[key] = copy.deepcopy(value)
    return result


def anchor_files(content: Content, folder: Path) -> None:
    """Make every ``file:`` of a scenario absolute, in place; relative paths start in the scenario's folder.

    ``plan: FILE`` of the site or a vehicle becomes ``plan: {file: FILE}``, as does ``geoid: FILE`` of the site, and
    ``wind: calm`` becomes ``wind: {type: calm}``, as of every component. A name that is not there but is one of the
    public recordings means the recording.
    """
    for part in _with_plans(content):
        if isinstance(part, dict):
            part |= {key: {"file": part[key]} for key in ("plan", "geoid") if isinstance(part.get(key), str)}
    _spell_out(content, [])
    _anchor(content, folder)


def _with_plans(content: Content) -> Iterator[object]:
    """Yield the parts of a scenario that may name a plan file: the site, and each vehicle."""
    yield content.get("site")
    fleets = content.get("fleets")
    for fleet in fleets.values() if isinstance(fleets, dict) else ():
        vehicles = fleet.get("vehicles") if isinstance(fleet, dict) else None
        yield from vehicles if isinstance(vehicles, list) else ()


def _spell_out(content: Content, path: list[str]) -> None:
    """Replace each component given by its type alone by {"type": ...}, in place; ``path`` is that of ``content``."""
    for key, value in content.items():
        inside = [*path, str(key)]
        if isinstance(value, dict):
            _spell_out(value, inside)
        elif isinstance(value, str) and component_types(ScenarioSpec, inside):
            content[key] = {"type": value}


def _anchor(content: object, folder: Path) -> None:
    """Make the file names in a scenario's content absolute, in place; relative ones start in ``folder``."""
    parts = content.values() if isinstance(content, dict) else content if isinstance(content, list) else ()
    for part in parts:
        _anchor(part, folder)
    if isinstance(content, dict):
        named = content.get("file")
        if isinstance(named, str) and named:
            content["file"] = _anchored(named, folder)
            if isinstance(params := content.get("params"), str) and params:
                content["params"] = _anchored(params, folder)
        elif isinstance(named, list):
            content["file"] = [_anchored(each, folder) if isinstance(each, str) and each else each for each in named]


def _anchored(name: str, folder: Path) -> str:
    """Return an absolute file name; a public recording that ``folder`` lacks is taken from the data folder."""
    file = Path(os.path.abspath(folder / os.path.expanduser(name)))
    return str(data_folder() / name if name in RECORDINGS and not file.exists() else file)


def _as_mapping(content: object, source: str) -> Content:
    """Return scenario content unchanged; raises ScenarioError unless it is a mapping."""
    if not isinstance(content, dict):
        kinds = {type(None): "nothing", list: "a list", str: "a text"}
        found = kinds.get(type(content), repr(content))
        raise ScenarioError(source, [f"expected keys and values such as name: hover, found {found}"])
    return content


def apply_override(content: Content, assignment: str) -> None:
    """Set one value by its path, such as ``world.wind.speed_20ft=7`` or ``world.wind=calm``, in place.

    A list entry is named by its index; a component is replaced by naming another type.

    Raises:
        UsageError: no path=value, or a path through something that is not there or has no parts.
        ScenarioError: the value is no YAML.
    """
    path, equals, text = assignment.partition("=")
    parts = path.strip().split(".")
    if not equals or not all(parts) or len(parts) > DEEPEST or max(map(len, parts)) > LONGEST_NAME:
        raise UsageError(f"--set {shortened(assignment)}: expected path=value, for example world.wind.speed_20ft=7")
    value = parse_yaml(text, f"--set {path}") if text.strip() else ""
    if crowded := _without_a_space(value):
        spaced = ": ".join(crowded.split(":", 1))
        raise UsageError(f"--set {shortened(assignment)}: '{crowded}' is one key in YAML; write '{spaced}'")
    target = content
    for depth in range(len(parts) - 1):
        target = _enter(target, parts, depth, assignment)
    last = parts[-1]
    if isinstance(value, str) and component_types(ScenarioSpec, parts):
        value = {"type": value}
    if isinstance(target, list):
        target[_index(target, parts, len(parts) - 1, assignment)] = value
        return
    _drop_twin(target, last)
    target[last] = value


def _without_a_space(value: object) -> str | None:
    """Return a YAML key such as 'type:gnss', which lacks the space before its value; None if all are right."""
    if isinstance(value, list):
        return next(filter(None, map(_without_a_space, value)), None)
    if not isinstance(value, dict):
        return None
    crowded = (key for key, inner in value.items() if inner is None and ":" in key.strip(":"))
    return next(crowded, None) or _without_a_space(list(value.values()))


_UNITS = (("_rad", "_deg"), ("_deg", "_rad"))
# What a number of a wind replaces: the speed at another height, the gust in another form.
_OF_ONE_WIND = {
    "speed": ("speed_20ft",),
    "speed_20ft": ("speed", "at_height", "gust", "gust_factor"),
    "gust": ("gust_factor",),
    "gust_factor": ("gust",),
}
_OF_ONE_SITE = {"height": ("height_amsl",), "height_amsl": ("height",)}


def _drop_twin(target: Content, name: str, kept: Container[str] = ()) -> None:
    """Remove keys of scenario content that ``name`` replaces, such as an angle in another unit, except ``kept``.

    Those in ``kept`` are given with it, and stay for the check of the whole to refuse.
    """
    twins = [name.removesuffix(unit) + other for unit, other in _UNITS if name.endswith(unit)]
    if name == "speed" or "speed" in target:
        twins += _OF_ONE_WIND.get(name, ())
    twins += _OF_ONE_SITE.get(name, ())
    if name in ("latitude_deg", "longitude_deg") and "height_amsl" in target:
        # A saved site has both heights, and elsewhere the geoid is another.
        twins.append("height")
    geoid = target.get("geoid") if name in ("latitude_deg", "longitude_deg") else None
    if isinstance(geoid, dict) and geoid.get("source"):
        # Its numbers are those of a file at the place of a saved site.
        twins.append("geoid")
    for twin in twins:
        if twin not in kept:
            target.pop(twin, None)


def _enter(target: Any, parts: list[str], depth: int, assignment: str) -> Any:
    """Return the child of ``target`` under the path's part number ``depth``; a missing child becomes {}."""
    name = parts[depth]
    if isinstance(target, list):
        child = target[_index(target, parts, depth, assignment)]
    else:
        _check_name(target, parts, depth, assignment)
        child = target.setdefault(name, {})
    if not isinstance(child, dict | list):
        hint = "; 'qrsim show' lists the sensors of a set, to save and change" if name == "sensors" else ""
        where = ".".join(parts[: depth + 1])
        raise UsageError(f"--set {assignment}: {where} is the value {child!r}, it has no parts{hint}")
    return child


def _check_name(target: Content, parts: list[str], depth: int, assignment: str) -> None:
    """Raise UsageError for an unknown fleet or sensor in an override's path, which it would otherwise create."""
    is_fleet = depth == 1 and parts[0] == "fleets"
    is_sensor = depth == 3 and parts[0] == "fleets" and parts[2] == "sensors" and parts[4:] != ["type"]
    if (is_fleet or is_sensor) and parts[depth] not in target:
        hint = did_you_mean(parts[depth], [str(name) for name in target])
        raise UsageError(f"--set {assignment}: no {'fleet' if is_fleet else 'sensor'} is called '{parts[depth]}'{hint}")


def _index(target: list[object], parts: list[str], depth: int, assignment: str) -> int:
    """Convert part number ``depth`` of an override's path to an index of a list; raise UsageError if it is none."""
    text = parts[depth]
    if re.fullmatch("[0-9]{1,9}", text) and int(text) < len(target):
        return int(text)
    allowed = f"an index from 0 to {len(target) - 1}" if target else "nothing, the list is empty"
    raise UsageError(f"--set {assignment}: {'.'.join(parts[: depth + 1])}: expected {allowed}, found '{text}'")
