"""Tasks that clients open by name, and scenarios that they upload."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate

import yaml

from qrsim.control.controllers import OffboardController
from qrsim.errors import ScenarioError, UsageError, did_you_mean
from qrsim.links.shared.injectable import of_those, with_injectable
from qrsim.scenarios.catalogue import CONTROLLERS, VEHICLES
from qrsim.scenarios.in_rows import count_of
from qrsim.scenarios.providing import outside_problems
from qrsim.scenarios.reading import built_in_names, parse_yaml
from qrsim.scenarios.scenario import Scenario, load_scenario

# Names of the reference implementation -> ours.
REFERENCE_TASKS = {
    "TaskKeepSpot": "keep_spot",
    "TaskKeepSpotWithReward": "keep_spot",
    "TaskKeepSpot10": "keep_spot_10",
    "TaskGotoWP": "goto_waypoint",
    "TaskKeepVel": "keep_velocity",
    "TaskComplacs": "free_flight",
    "TaskCatsMouseNoiseless": "cats_and_mouse/1A",
    "TaskCatsMouseNoisy": "cats_and_mouse/1B",
    "TaskCatsMouseNoisyAndWindy": "cats_and_mouse/1C",
    "TaskSearchRescueSingleNoiseless": "search_and_rescue/2A",
    "TaskSearchRescueSingleNoisy": "search_and_rescue/2B",
    "TaskSearchRescueMultipleNoiseless": "search_and_rescue/2C",
    "TaskSearchRescueMultipleNoisyAndWindy": "search_and_rescue/2D",
    "TaskPlumeSingleSourceGaussian": "plume_mapping/3A",
    "TaskPlumeSingleSourceGaussianDispersion": "plume_mapping/3B",
    "TaskPlumeMultiSourceGaussianDispersion": "plume_mapping/3C",
    "TaskPlumeMultiHeliMultiSourceGaussianDispersion": "plume_mapping/3D",
    "TaskPlumeSingleSourceGaussianPuffDispersion": "plume_mapping/3E",
    "TaskPlumeMultiSourceGaussianPuffDispersion": "plume_mapping/3F",
    "TaskPlumeMultiHeliMultiSourceGaussianPuffDispersion": "plume_mapping/3G",
}
LARGEST_SCENARIO, DEEPEST = 256 * 1024, 100
MOST_FLEETS, MOST_SENSORS, MOST_VEHICLES = 8, 16, 1000
# Settings that memory grows with, and that scenarios of the operator may have as large as he likes.
LARGEST = {"puffs": 10_000, "most_columns": 200, "most_rows": 200, "locations": 1000, "samples": 5000}
_GAINS = [field.name for field in dataclasses.fields(OffboardController)]


def offboard(scenario: Scenario) -> Scenario:
    """Return a scenario whose controllers are replaced by ones that accept every kind of set-point, with the same gains
    where named alike.

    Fleets whose controller takes them all keep it, as do vehicles that this one does not fly.
    """
    content = scenario.spec.model_dump(mode="json")
    for fleet in content["fleets"].values():
        if OffboardController.gives not in VEHICLES[fleet["vehicle"]["type"]].actions:
            continue
        own = CONTROLLERS[fleet["controller"]["type"]]
        if set(own.setpoints) >= set(OffboardController.setpoints):
            continue
        gains = {name: value for name, value in fleet["controller"].items() if name in _GAINS}
        fleet["controller"] = {"type": "offboard", **gains}
    return load_scenario(content, quiet=True)


class Tasks:
    """The tasks of a server.

    Args:
        own: the operator's scenario, which an empty name means too; None: there is none.
        asked: what the operator calls it, where that is not its own name.
        injectable: what clients may let fail, where a scenario has it; see ``may_fail``.

    Raises:
        UsageError: the operator's scenario has no sensor that is ``injectable``.
    """

    def __init__(self, own: Scenario | None = None, asked: str | None = None, injectable: Sequence[str] = ()):
        self.own = None if own is None else with_injectable(own, injectable)
        self._injectable = injectable
        self._own_names = {"", own.name} if own else set()
        if own and asked and ours(asked) in built_in_names():
            self._own_names.add(ours(asked))
        self._loaded: dict[str, Scenario] = {}

    @property
    def names(self) -> list[str]:
        """Names of the available tasks."""
        own = [self.own.name] if self.own else []
        return [*own, *(name for name in built_in_names() if name not in own), *REFERENCE_TASKS]

    def offboard(self, name: str) -> Scenario:
        """Return a task's scenario, changed to accept every kind of command; raises UsageError for an unknown task.

        Raises:
            UsageError: no task is called so.
        """
        known = self._known_name(name)
        if known not in self._loaded:
            self._loaded[known] = self.flown(self.scenario(name))
        return self._loaded[known]

    def flown(self, scenario: Scenario) -> Scenario:
        """Return a scenario changed to accept every kind of command, and with parts in which faults may be injected."""
        return offboard(with_injectable(scenario, of_those(scenario, self._injectable)))

    def scenario(self, name: str) -> Scenario:
        """Return a task's scenario unchanged; raises UsageError for an unknown task.

        Raises:
            UsageError: no task is called so.
        """
        known = self._known_name(name)
        if self.own and not known:
            return self.own
        if known in built_in_names():
            return load_scenario(known)
        raise UsageError(f"no task is called '{_shortened(name)}'{did_you_mean(name[:100], self.names)}")

    def _known_name(self, name: str) -> str:
        """Return the scenario name of a task; "" for the scenario that the operator serves."""
        return "" if self.own and {name, ours(name)} & self._own_names else ours(name)


def ours(name: str) -> str:
    """Translate a task name of the reference implementation to this package's; other names stay."""
    return REFERENCE_TASKS.get(name, name)


def uploaded(text: str) -> Scenario:
    """Parse the YAML text of a scenario that a client has uploaded; raises UsageError for invalid or forbidden content.

    Raises:
        UsageError: it is too large, names files, or is wrong.
    """
    size = len(text.encode())
    if size > LARGEST_SCENARIO:
        raise UsageError(f"scenario: {size} bytes; allowed: up to {LARGEST_SCENARIO}")
    try:
        if _nesting_depth(text) > DEEPEST:
            raise RecursionError
        _refuse_aliases(text)
        content = parse_yaml(text, "scenario")
        problems = list(_upload_problems(content))
        if problems:
            raise ScenarioError("scenario", problems)
        return load_scenario(content, local=False)
    except RecursionError:
        raise UsageError("scenario: nested too deeply") from None


def _nesting_depth(text: str) -> int:
    """Return the nesting depth of brackets in a text; the parser is slow for deep ones."""
    return max(accumulate((char in "[{") - (char in "]}") for char in text), default=0)


def _refuse_aliases(text: str) -> None:
    """Raise UsageError for YAML aliases in an uploaded text, by which a small text can expand to a huge one."""
    try:
        for token in yaml.scan(text, Loader=yaml.SafeLoader):
            if isinstance(token, yaml.AliasToken):
                raise ScenarioError("scenario", [f"line {token.start_mark.line + 1}: '*' is not allowed here"])
    except yaml.YAMLError:
        return  # the parser says what is wrong


def _upload_problems(content: object) -> Iterator[str]:
    """Yield what an uploaded scenario may not have: file names, parents outside the package, numbers above the
    limits."""
    if not isinstance(content, dict):
        yield "expected keys and values such as name: hover"
        return
    parent = content.get("extends")
    if parent is not None and parent not in built_in_names():
        yield f"extends: expected the name of a built-in scenario, found {_shortened(str(parent))!r}"
    for path, key, value in _entries(content, ""):
        if key == "file":
            yield f"{path}: a scenario that a client sends can name no files"
        if isinstance(value, int) and value > LARGEST.get(key, value):
            yield f"{path}: {value}; allowed in a scenario that a client sends: up to {LARGEST[key]}"
    yield from outside_problems(content)
    fleets = content.get("fleets")
    if not isinstance(fleets, Mapping):
        return
    if len(fleets) > MOST_FLEETS:
        yield f"fleets: {len(fleets)}; allowed: up to {MOST_FLEETS}"
    vehicles = 0
    for name, fleet in fleets.items():
        if not isinstance(fleet, Mapping):
            continue
        vehicles += count_of(fleet.get("vehicles"))
        if _length(fleet.get("sensors")) > MOST_SENSORS:
            yield f"fleets.{name}.sensors: {_length(fleet['sensors'])}; allowed: up to {MOST_SENSORS}"
    if vehicles > MOST_VEHICLES:
        yield f"fleets: {vehicles} vehicles; allowed: up to {MOST_VEHICLES}"


def _length(value: object) -> int:
    """Return the length of a list or dict; 0 for other values."""
    return len(value) if isinstance(value, list | dict) else 0


def _entries(part: object, path: str) -> Iterator[tuple[str, str, object]]:
    """Yield (path, key, value) of every key, at any depth, of an uploaded scenario's content."""
    for key, value in part.items() if isinstance(part, dict) else enumerate(part) if isinstance(part, list) else ():
        where = f"{path}.{key}" if path else str(key)
        if isinstance(part, dict):
            yield where, str(key), value
        yield from _entries(value, where)


def _shortened(name: str) -> str:
    """Return a name with at most 60 characters, "..." for the rest."""
    return name if len(name) <= 60 else f"{name[:57]}..."
