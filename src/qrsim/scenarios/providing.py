"""Loads the components from outside that a scenario names, at each place of its content."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from qrsim.errors import ScenarioError, UsageError, did_you_mean
from qrsim.files import Content, code
from qrsim.scenarios import catalogue, registry
from qrsim.scenarios.schema import FLEET_KINDS, SKY_KINDS, WORLD_KINDS

# How to load the code that a recorded scenario names.
TRUST = "if you trust its author, --code loads it, in Python open_run(..., code=True)"


def places(content: object) -> Iterator[tuple[str, str, Content]]:
    """Yield (path, kind, content) of every component in a scenario's content that has a type."""
    for path, kind, part in _parts(content):
        if isinstance(part, dict) and isinstance(part.get("type"), str):
            yield path, kind, part


def _parts(content: object) -> Iterator[tuple[str, str, object]]:
    """Yield (path, kind, content) of each place in a scenario's content that takes a component."""
    world, fleets = _mapping(content, "world"), _mapping(content, "fleets")
    for kind in WORLD_KINDS:
        yield f"world.{kind}", kind, world.get(kind)
    updrafts = world.get("updrafts")
    for i, part in enumerate(updrafts if isinstance(updrafts, list) else ()):
        yield f"world.updrafts.{i}", "updraft", part
    for kind, part in SKY_KINDS.items():
        yield f"world.sky.{part}", kind, _mapping(world, "sky").get(part)
    for name in fleets:
        fleet = _mapping(fleets, name)
        for kind in (*FLEET_KINDS, "placement"):
            yield f"fleets.{name}.{kind}", kind, fleet.get(kind)
        for sensor, part in _mapping(fleet, "sensors").items():
            yield f"fleets.{name}.sensors.{sensor}", "sensor", part
    yield "task", "task", _mapping(content, "").get("task")


def _mapping(content: object, key: object) -> Content:
    """Return ``content[key]`` (``content`` for an empty key) if it is a mapping, else {}."""
    found = content.get(key) if key and isinstance(content, dict) else content
    return found if isinstance(found, dict) else {}


def anchor_code(content: object, folder: Path) -> None:
    """Make file paths in ``type: ./file.py:Class`` absolute, in place; relative ones start in ``folder``."""
    for _, _, part in places(content):
        if code.is_code(part["type"]):
            part["type"] = code.anchored(part["type"], folder)


def provide_components(content: object, source: str, named_code: bool = True) -> None:
    """Load and register the scenario's components from packages or Python files; ``named_code`` allows files.

    Args:
        content: of the scenario.
        source: of it, for messages.
        named_code: whether to load files and modules that it names; else those of installed packages alone.

    Raises:
        ScenarioError: some cannot be loaded, or are no such components; all are listed.
    """
    problems = []
    for path, kind, part in places(content):
        name = part["type"]
        if code.is_code(name) and not named_code:
            if name not in catalogue.KINDS[kind]:
                problems.append(f"{path}.type: {name} is Python code, which is not loaded to read a run; {TRUST}")
            continue
        try:
            registry.provide(kind, name)
        except UsageError as error:
            problems.append(f"{path}.type: {error}")
    if problems:
        raise ScenarioError(source, problems)


def outside_components(content: object) -> list[dict[str, str]]:
    """Return a record for the run folder, as a dict, of each component of a scenario that is not built in."""
    found = []
    for path, kind, part in places(content):
        name = part["type"]
        # "fence" is a polygon whose corners are in a file.
        if name in catalogue.KINDS[kind] and registry.is_outside(kind, name):
            origin = registry.origin_of(kind, name)
            title = f"{origin.module}:{catalogue.KINDS[kind][name].__qualname__}"
            found.append(
                {
                    "path": path,
                    "kind": kind,
                    "type": name,
                    "class": title,
                    "file": origin.file,
                    "sha256": origin.sha256,
                    "from": f"{origin.how}: {origin.place}",
                }
            )
    return found


def outside_problems(content: object) -> Iterator[str]:
    """Yield an error for each component in a client's scenario that would make this machine load other code."""
    for path, kind, part in places(content):
        name = part["type"]
        if code.is_code(name) or ":" in name:
            known = ", ".join(registry.built_in_names(kind))
            yield f"{path}.type: a scenario that a client sends can name no code; known: {known}"
        elif registry.is_outside(kind, name) and registry.outside_names(kind):
            # What the operator has of his own is nothing that a client need know.
            yield f"{path}.type: no such type '{name}'{did_you_mean(name, registry.built_in_names(kind))}"
