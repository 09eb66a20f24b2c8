"""The stage of faults: each fault at 25, 50 and 75 % of the mission, in plain runs with the failsafes of the fleets."""

from __future__ import annotations

import copy
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import ScenarioError
from qrsim.files import Content
from qrsim.scenarios.scenario import load_scenario
from qrsim.studies.brief.flights import Flights
from qrsim.studies.brief.judging import Row, Verdict
from qrsim.studies.brief.operation import OperationSpec
from qrsim.studies.brief.studying import METRICS, TRACK_S
from qrsim.studies.sweep.results import Results

NAME, SCENARIO = "faults", "faults_scenario.yaml"
PARTS, SEEDS = (0.25, 0.5, 0.75), 8
STATION = "ground_station"
# Where the station of the link may stand, from the first home [m], and how near to its start a vehicle is at home.
BESIDE, AT_HOME_M = ((5.0, 0.0), (-5.0, 0.0), (0.0, 5.0), (0.0, -5.0)), 10.0
# Shares of the runs that come home from which on a fault is a go, and below which it is a no-go.
HOME_GO, HOME_NO_GO = 0.95, 0.5
# Faults that decide; a quadrotor without a rotor falls, and one without GNSS drifts.
DECIDING = ("link", "low_battery")
# Of a fleet's faults, the key of the time of each.
_TIMES = {"gnss": "start", "motor": "at", "link": "at", "low_battery": "at"}


@dataclass(frozen=True)
class FaultOutcome:
    """How the runs with a fault ended, as shares; the fault hits every vehicle.

    Attributes:
        fault: its name.
        part: of the mission's time at which it begins.
        runs: how many were flown.
        home, elsewhere, left_area, crashed, airborne: shares of the runs by how the worst vehicle ended.
        median_s: median time from the fault to the end of the worst ones, None if all came home.
    """

    fault: str
    part: float
    runs: int
    home: float
    elsewhere: float
    left_area: float
    crashed: float
    airborne: float
    median_s: float | None

    def to_json(self) -> Content:
        """Return the outcome of a fault as a dict for JSON."""
        return asdict(self)


def fault_scenario(operation: OperationSpec, flights: Flights) -> Content:
    """Return scenario content with the operation's faults, at first after the missions, and a station for link loss.

    Raises:
        ScenarioError: the station has no room next to the first home.
    """
    content = copy.deepcopy(flights.content)
    content["name"] = NAME
    contingency = operation.contingency
    never, low = _never(flights), contingency.low_battery.at
    faults: dict[str, Content] = {
        "gnss": {"type": "sensor", "sensor": "gnss", "kind": "off", "start": never},
        "motor": {"type": "rotor", "rotor": 0, "health": 0.0, "at": never},
        "link": {"type": "radio", "kind": "off", "at": never},
        "low_battery": {"type": "battery", "charge": low, "at": never},
    }
    for fleet in content["fleets"].values():
        names = [vehicle["name"] for vehicle in fleet["vehicles"]]
        fleet["faults"] = [
            {**faults[fault], **({"vehicles": [name]} if len(names) > 1 else {})}
            for name in names
            for fault in operation.faults
        ]
        if "link" in operation.faults:
            fleet["failsafes"] |= {"COM_DL_LOSS_T": contingency.link_lost.after}
            if contingency.link_lost.do != "none":
                fleet["failsafes"] |= {"NAV_DLL_ACT": contingency.link_lost.do, "link_to": STATION}
    if "link" not in operation.faults:
        return content
    content["world"]["radio"] = "sik_915"
    return _with_station(content, flights)


def _with_station(content: Content, flights: Flights) -> Content:
    """Return scenario content with a fixed radio station near the first start; ScenarioError if no place is free."""
    north, east, _ = content["fleets"][flights.places[0].fleet]["vehicles"][0]["position_ned"]
    problems: list[str] = []
    for away_north, away_east in BESIDE:
        station = {
            "vehicle": {"type": "fixed_point"},
            "controller": {"type": "none"},
            "vehicles": [{"name": STATION, "position_ned": [north + away_north, east + away_east, -2.0]}],
        }
        found = {**content, "fleets": {**content["fleets"], STATION: station}}
        try:
            load_scenario(found, quiet=True)
        except ScenarioError as error:
            problems = error.problems
            continue
        return found
    raise ScenarioError(NAME, problems)


def _never(flights: Flights) -> float:
    """Return a time [s] near the end of a run, at which faults no longer affect the mission."""
    return float(flights.content["duration"]) - 0.1


def fault_study(operation: OperationSpec, flights: Flights, finished_s: float, seed: int) -> Content:
    """Return a study's content: a condition for each fault and part of the mission, all with the same seeds.

    Args:
        operation: with its faults.
        flights: what is flown.
        finished_s: time at which a mission ends [s].
        seed: of the first run.
    """
    conditions: dict[str, Content] = {}
    longest = max(flights.planned_s)
    for number, fault in enumerate(operation.faults):
        for part in PARTS:
            settings = {}
            for place, planned in zip(flights.places, flights.planned_s, strict=True):
                at = round(part * planned * finished_s / longest, 1)
                entry = place.row * len(operation.faults) + number
                settings[f"fleets.{place.fleet}.faults.{entry}.{_TIMES[fault]}"] = at
            conditions[f"{fault}_{round(100 * part)}"] = settings
    return {
        "name": NAME,
        "description": f"Faults of the brief {operation.operation}.",
        "scenario": SCENARIO,
        "vary": {"fault": {"conditions": conditions}},
        "seeds": SEEDS,
        "first_seed": seed,
        "metrics": list(METRICS),
        "track": TRACK_S,
        "batch": SEEDS,
    }


def fault_outcomes(path: Path, study: Content) -> list[FaultOutcome]:
    """Read the store of a study of faults; return the outcome of the runs under each condition."""
    results = Results(path)
    conditions: Content = study["vary"]["fault"]["conditions"]
    found = []
    for number, (name, settings) in enumerate(conditions.items()):
        here = results.points == number
        if here.any():
            fault, _, part = name.rpartition("_")
            times = list(settings.values())
            found.append(_outcome(results, here, fault, int(part) / 100.0, min(times)))
    return found


def _outcome(results: Results, here: NumpyArray, fault: str, part: float, begun: float) -> FaultOutcome:
    """Return the outcome of runs ``here`` (a mask) with a fault at ``begun`` [s], fraction ``part`` of the mission."""

    def of(metric: str) -> NumpyArray:
        """Return the values of a metric in the runs in mask ``here``."""
        return results.metric(metric)[here]

    crashed = (of("crashed") > 0.0) | ((of("stopped") > 0.0) & (of("left_area") == 0.0))
    left = ~crashed & (of("left_area") > 0.0)
    airborne = ~crashed & ~left & (of("in_the_air") > 0.0)
    home = ~crashed & ~left & ~airborne & (of("home_m") <= AT_HOME_M)
    elsewhere = ~crashed & ~left & ~airborne & ~home
    ended = np.where(of("stopped") > 0.0, of("stopped_s"), of("down_s")) - begun
    bad = ended[~home & np.isfinite(ended)]
    return FaultOutcome(
        fault=fault,
        part=part,
        runs=int(here.sum()),
        home=float(home.mean()),
        elsewhere=float(elsewhere.mean()),
        left_area=float(left.mean()),
        crashed=float(crashed.mean()),
        airborne=float(airborne.mean()),
        median_s=float(np.median(bad)) if len(bad) else None,
    )


def fault_rows(outcomes: list[FaultOutcome]) -> list[Row]:
    """Return a row with a verdict for each fault, by the share of runs that come home over all parts of the mission."""
    rows = []
    for fault in dict.fromkeys(each.fault for each in outcomes):
        own = [each for each in outcomes if each.fault == fault]
        runs = sum(each.runs for each in own)
        home = sum(each.home * each.runs for each in own) / runs
        lost = sum((each.crashed + each.left_area) * each.runs for each in own) / runs
        verdict: Verdict = "go" if home >= HOME_GO else "no-go" if home < HOME_NO_GO else "marginal"
        told = f"fault {fault}: {100 * home:.0f} % of {runs} runs come home, {100 * lost:.0f} % are lost"
        rows.append(Row(f"fault {fault}", verdict, home, None, HOME_GO, "1", told, None, fault in DECIDING))
    return sorted(rows, key=lambda row: row.value or 0.0)
