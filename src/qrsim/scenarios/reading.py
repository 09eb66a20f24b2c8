"""Reading scenario text: YAML with no surprises, built-in names, and ``--set`` overrides."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path
from typing import Any

import yaml

from qrsim.errors import ScenarioError, UsageError, did_you_mean


class _Loader(yaml.SafeLoader):
    """Safe YAML that refuses a key given twice and reads 1e-3 as the number it is."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: dict[Any, int] = {}
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            line = key_node.start_mark.line + 1
            if not isinstance(key, str):
                raise yaml.MarkedYAMLError(problem=f"the key {key!r} is not a text", problem_mark=key_node.start_mark)
            if key in seen:
                problem = f"'{key}' is given twice, first in line {seen[key]}"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key_node.start_mark)
            seen[key] = line
        return super().construct_mapping(node, deep)


_Loader.yaml_implicit_resolvers = {key: list(value) for key, value in yaml.SafeLoader.yaml_implicit_resolvers.items()}
_FLOAT = re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")
for _first in "-+.0123456789":
    _Loader.yaml_implicit_resolvers.setdefault(_first, []).append(("tag:yaml.org,2002:float", _FLOAT))


def parse_yaml(text: str, source: str) -> Any:
    """Parse YAML text; a fault names its line and column."""
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise ScenarioError(source, [f"{where}{error.problem or error.context}"]) from None
    except yaml.YAMLError as error:
        raise ScenarioError(source, [str(error)]) from None


def built_in_names() -> list[str]:
    """Return the names of the scenarios that come with qrsim."""
    folder = resources.files("qrsim.scenarios")
    return sorted(item.name.removesuffix(".yaml") for item in folder.iterdir() if item.name.endswith(".yaml"))


def read_scenario(source: str | Path | dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return (what to call the source in messages, its content) of a name, a YAML path or a dict."""
    if isinstance(source, dict):
        return "scenario", source
    name = str(source)
    if name in built_in_names():
        text = (resources.files("qrsim.scenarios") / f"{name}.yaml").read_text("utf-8")
        return _as_mapping(parse_yaml(text, name), name)
    path = Path(source)
    if path.suffix not in (".yaml", ".yml"):
        hint = did_you_mean(name, built_in_names())
        raise UsageError(f"no scenario is called '{name}'{hint} (or give the path of a .yaml file)")
    try:
        text = path.read_text("utf-8")
    except FileNotFoundError:
        near = [str(item) for item in path.parent.glob("*.y*ml")] if path.parent.is_dir() else []
        hint = did_you_mean(name, near) if near else ""
        raise UsageError(f"scenario file {path}: no such file{hint}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"scenario file {path}: cannot be read: {error}") from None
    return _as_mapping(parse_yaml(text, name), name)


def _as_mapping(content: Any, source: str) -> tuple[str, dict[str, Any]]:
    if not isinstance(content, dict):
        raise ScenarioError(source, [f"expected keys and values, found {type(content).__name__}"])
    return source, content


def apply_override(content: dict[str, Any], assignment: str) -> None:
    """Set one value by its path, for example ``world.wind.speed_20ft=7`` or ``world.wind=calm``.

    A list entry is named by its index; a component is replaced by naming another type.
    """
    path, equals, text = assignment.partition("=")
    parts = path.strip().split(".")
    if not equals or not all(parts):
        raise UsageError(f"--set {assignment}: expected path=value, for example world.wind.speed_20ft=7")
    value = parse_yaml(text, f"--set {path}") if text.strip() else ""
    target: Any = content
    for depth, part in enumerate(parts[:-1]):
        target = _enter(target, part, ".".join(parts[: depth + 1]), assignment)
    last = parts[-1]
    if isinstance(target, list):
        index = _index(target, last, path, assignment)
        target[index] = value
        return
    _drop_twin(target, last)
    current = target.get(last)
    names_type = isinstance(value, str) and (isinstance(current, dict) and "type" in current)
    in_world = parts[:-1] == ["world"] and last in ("wind", "turbulence", "area")
    target[last] = {"type": value} if names_type or (in_world and isinstance(value, str)) else value


def _drop_twin(target: dict[str, Any], name: str) -> None:
    """An angle that is overridden in one unit must not stay in the other."""
    for unit, other in (("_rad", "_deg"), ("_deg", "_rad")):
        if name.endswith(unit):
            target.pop(name.removesuffix(unit) + other, None)


def _enter(target: Any, part: str, path: str, assignment: str) -> Any:
    if isinstance(target, list):
        return target[_index(target, part, path, assignment)]
    child = target.setdefault(part, {})
    if not isinstance(child, dict | list):
        raise UsageError(f"--set {assignment}: {path} is the value {child!r}, it has no parts")
    return child


def _index(target: list[Any], part: str, path: str, assignment: str) -> int:
    if part.isdigit() and int(part) < len(target):
        return int(part)
    raise UsageError(f"--set {assignment}: {path}: expected an index from 0 to {len(target) - 1}, found '{part}'")
