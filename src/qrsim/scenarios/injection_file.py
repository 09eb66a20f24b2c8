"""Files of injections, as ``qrsim run --inject`` takes them: faults of sensors and rotors at given times."""

from __future__ import annotations

import re
from pathlib import Path

from qrsim.errors import ScenarioError, UsageError, did_you_mean, did_you_mean_file
from qrsim.files import Content
from qrsim.files.yaml_text import parse_yaml
from qrsim.scenarios.faults import rotors_of, vehicle_names
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.simulation.injections import ROTOR_KINDS

LARGEST_BYTES, MOST_ENTRIES = 2**24, 10_000


def with_injections(scenario: Scenario, path: Path) -> Scenario:
    """Return a scenario with the faults of a file.

    Args:
        scenario: what is flown.
        path: a list of entries with ``target`` (a sensor or ``rotor N``), ``kind``, ``at`` [s], perhaps ``end`` [s] and
            ``vehicles``, and the numbers of the kind; without vehicles an entry is of each fleet that has the target.

    Raises:
        UsageError: the file cannot be read, is too large, or an entry is no injection.
        ScenarioError: a fault is not possible in the scenario.
    """
    content = scenario.spec.model_dump(mode="json")
    for number, entry in enumerate(_entries(path)):
        where = f"{path}: entry {number + 1}"
        if not isinstance(entry, dict):
            raise UsageError(f"{where}: expected target, kind, at and the like, not {type(entry).__name__}")
        for name in ("target", "kind", "at"):
            if name not in entry:
                raise UsageError(f"{where}: {name} is missing")
        target, vehicles = str(entry["target"]), entry.get("vehicles")
        if vehicles is not None and not (isinstance(vehicles, list) and all(isinstance(one, str) for one in vehicles)):
            raise UsageError(f"{where}: vehicles: expected a list of names")
        rotor = re.fullmatch(r"rotor[ _]([0-9]{1,3})", target)
        if rotor:
            _check_rotor(where, entry)
        placed, placed_all = False, set[str]()
        for name, fleet in scenario.spec.fleets.items():
            known = vehicle_names(name, fleet)
            mine = None if vehicles is None else [each for each in vehicles if each in known]
            placed_all = placed_all.union(mine or ())
            if mine == [] or not (int(rotor[1]) < rotors_of(fleet) if rotor else target in fleet.sensors):
                continue
            content["fleets"][name]["faults"].append(_fault(entry, rotor and int(rotor[1]), mine))
            placed = True
        unknown = [one for one in vehicles or () if one not in placed_all]
        if unknown:
            everybody = [one for name, fleet in scenario.spec.fleets.items() for one in vehicle_names(name, fleet)]
            raise UsageError(f"{where}: no vehicle is called '{unknown[0]}'{did_you_mean(unknown[0], everybody)}")
        if not placed:
            whom = "" if vehicles is None else f" of {', '.join(map(str, vehicles))}"
            raise UsageError(f"{where}: there is no target '{target}'{whom}{did_you_mean(target, _targets(scenario))}")
    try:
        return load_scenario(content, quiet=True)
    except ScenarioError as error:
        raise UsageError(f"{path}: {error}") from None


def _entries(path: Path) -> list[object]:
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise UsageError(f"{path}: larger than {LARGEST_BYTES // 2**20} MB")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}{did_you_mean_file(path)}") from None
    except UnicodeDecodeError:
        raise UsageError(f"{path}: it is no text in UTF-8") from None
    content = parse_yaml(text, str(path))
    if not isinstance(content, list):
        raise UsageError(f"{path}: expected a list of injections, not {type(content).__name__}")
    if len(content) > MOST_ENTRIES:
        raise UsageError(f"{path}: {len(content)} entries; allowed: at most {MOST_ENTRIES}")
    return content


def _targets(scenario: Scenario) -> list[str]:
    """Return what may fail in any fleet."""
    fleets = scenario.spec.fleets.values()
    sensors = {sensor for fleet in fleets for sensor in fleet.sensors}
    return [*sorted(sensors), *(f"rotor {i}" for i in range(max(map(rotors_of, fleets))))]


def _check_rotor(where: str, entry: Content) -> None:
    """Refuse what is no fault of a rotor: it is off, or weak with a health."""
    kind = entry["kind"]
    if kind not in ROTOR_KINDS:
        raise UsageError(f"{where}: kind '{kind}' does not suit a rotor; allowed: {', '.join(ROTOR_KINDS)}")
    if (kind == "weak") != ("health" in entry):
        raise UsageError(
            f"{where}: health: " + ("missing; kind 'weak' needs it" if kind == "weak" else "only for kind 'weak'")
        )


def _fault(entry: Content, rotor: int | None, vehicles: list[str] | None) -> Content:
    """Return an entry as a fault of a fleet."""
    rest = {name: value for name, value in entry.items() if name not in ("target", "at", "vehicles", "asked_by")}
    chosen = {} if vehicles is None else {"vehicles": vehicles}
    if rotor is None:
        return rest | chosen | {"sensor": entry["target"], "start": entry["at"]}
    health = {"health": 0.0} if rest.pop("kind") == "off" else {}
    return health | rest | chosen | {"type": "rotor", "rotor": rotor, "at": entry["at"]}
