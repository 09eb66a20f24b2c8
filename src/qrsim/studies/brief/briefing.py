"""A brief from its operation to its verdict: the stages in their order, what they found, and the numbers as JSON."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.files import Content
from qrsim.files.atomic import write_atomically
from qrsim.files.yaml_text import dump_yaml, parse_yaml
from qrsim.runs.recorder import fly as record
from qrsim.scenarios.scenario import load_scenario
from qrsim.studies.brief import faults
from qrsim.studies.brief.boundary import Boundary
from qrsim.studies.brief.flights import Flights
from qrsim.studies.brief.judging import Row, Verdict, judge, overall, undecided
from qrsim.studies.brief.operation import OperationSpec
from qrsim.studies.brief.runs import Runs
from qrsim.studies.brief.sky import Sky, sky_of, sky_row
from qrsim.studies.brief.statistics import quantile, wilson
from qrsim.studies.brief.studying import SCENARIO, Flyer, Piece, nominal_study, pieces
from qrsim.studies.brief.volumes import Volumes, volumes_of
from qrsim.studies.brief.winds import Winds, boundary_of, wind_row, winds_of
from qrsim.studies.sweep.varying import assignment

STAGES = ("nominal", "faults", "wind")
# Shares of the time that is left, among the stages that are left.
SHARES = {"nominal": 0.6, "faults": 0.2, "wind": 0.2}
# Runs whose flights are named again, and metrics that the page and the JSON give as quantiles.
WORST = 3
# Folder of recorded runs.
RECORDINGS = "runs"
QUANTILES = {
    "charge_end": "1", "finished_s": "s", "wind_max_m_s": "m/s", "tracking_error_max_m": "m",
    "gnss_horizontal_rms_m": "m", "gnss_vertical_rms_m": "m", "fence_horizontal_min_m": "m", "ceiling_min_m": "m",
    "ground_min_m": "m", "obstacle_min_m": "m", "air_separation_min_m": "m",
}  # fmt: skip
NOT_MODELLED = (
    "Not modelled: wind near trees and buildings, thermals, rain, icing, cold or aged batteries, moving payloads, "
    "pilots, electromagnetic interference, damaged propellers, firmware.",
    "Orbits are nominal, not those of that day, unless the scenario names an SP3 file.",
    "A simulation is no permission.",
)


@dataclass
class Brief:
    """A brief so far.

    Attributes:
        operation: what is to be flown.
        flights: its scenario.
        folder: its files.
        seed: of the first run.
        runs: nominal runs.
        sky: GNSS of the day, None before it is computed.
        nominal: rows of the nominal stage.
        outcomes: of faults.
        winds: that were flown, None before they are.
        boundary: of these winds.
        precision: width of the intervals of the shares at which the runs end, None for a verdict alone.
        recordings: folders of runs that were recorded, by their numbers.
        complete: whether it ended by itself, and not by an interruption or its time.
        left_out: stages for which no time was left.
    """

    operation: OperationSpec
    flights: Flights
    folder: Path
    seed: int
    runs: Runs
    sky: Sky | None = None
    nominal: list[Row] = field(default_factory=list)
    outcomes: list[faults.FaultOutcome] = field(default_factory=list)
    winds: Winds | None = None
    boundary: Boundary | None = None
    precision: float | None = None
    recordings: dict[int, str] = field(default_factory=dict)
    complete: bool = False
    left_out: list[str] = field(default_factory=list)

    @property
    def rows(self) -> list[Row]:
        """Every criterion of the brief as a row with its verdict."""
        found = list(self.nominal)
        wind = wind_row(self.flights, self.operation.criteria.wind_limit, self.winds, self.boundary)
        if wind is not None:
            found.append(wind)
        if self.sky is not None:
            found.append(sky_row(self.sky, self.flights.scenario.duration + 60.0 * self.operation.window))
        return [*found, *faults.fault_rows(self.outcomes)]

    @property
    def verdict(self) -> tuple[Verdict, str]:
        """The brief's verdict (go, marginal, no-go) and its reason; without flights it is marginal at best."""
        found = overall(self.rows)
        if not self.nominal and found[0] == "go":
            return "marginal", "no run without faults was flown in the forecast"
        return found

    def missing_text(self) -> str:
        """Return as text why the brief is incomplete; "" for a complete one."""
        if self.left_out:
            return f"not flown, because no time was left: {', '.join(self.left_out)}"
        return "" if self.complete else "the brief was stopped before it was complete"

    def precise(self) -> bool:
        """Return whether the confidence interval of every share is as narrow as requested."""
        shares = [(self.runs[kind] > 0.0).sum() for kind in ("stopped", "not_finished")]
        widths = [high - low for low, high in (wilson(int(hits), len(self.runs)) for hits in shares)]
        return self.precision is None or max(widths) <= self.precision

    def worst(self) -> list[int]:
        """Return the indices of the worst runs: lost ones, then by charge, distance to the fence and tracking error."""
        runs = self.runs
        if not len(runs):
            return []
        lost = np.flatnonzero(runs["stopped"] > 0.0)
        order = list(lost[np.argsort(runs["stopped_s"][lost], kind="stable")])
        order += list(np.flatnonzero(runs["not_finished"] > 0.0)[:1])
        for metric, sign in (("charge_end", 1.0), ("fence_horizontal_min_m", 1.0), ("tracking_error_max_m", -1.0)):
            values = sign * runs[metric]
            if np.isfinite(values).any():
                order.append(np.nanargmin(values))
        return [int(run) for run in dict.fromkeys(order)][:WORST]

    @property
    def volumes(self) -> Volumes:
        """Flight and contingency volumes and ground risk buffer of the flights, for a risk assessment."""
        return volumes_of(self.flights.scenario)

    def departure(self) -> float | None:
        """Return the distance [m] from the planned path within which 99 % of the runs stay; None without runs."""
        found = quantile(self.runs["tracking_error_max_m"], 0.99)
        return found if math.isfinite(found) else None

    def volumes_text(self) -> str:
        """Return the sizes of the operational volumes as text, compared with the simulated departures from the path."""
        sizes, left = self.volumes, self.departure()
        simulated = (
            "" if left is None else f"; in 99 % of the runs no vehicle is farther than {left:.1f} m from its path"
        )
        return (
            f"contingency volume {sizes.contingency:.1f} m wide (7 m of errors, {sizes.reaction:.1f} m of reaction, "
            f"{sizes.braking:.1f} m of braking from {sizes.speed:g} m/s) and {sizes.contingency_height:.1f} m high, "
            f"ground risk buffer {sizes.ground_risk:.1f} m, 1:1{simulated}"
        )

    def command(self, run: int) -> str:
        """Return the shell command that flies run number ``run`` again."""
        values = [assignment(path, value) for path, value in self.runs.values_at(run).items()]
        words = ["qrsim", "run", str(self.folder / SCENARIO), "--seed", str(int(self.runs.seeds[run]))]
        return shlex.join([*words, *(word for value in values for word in ("--set", value))])

    def to_json(self) -> Content:
        """Return the brief as a dict for JSON; equal runs give bit-identical numbers."""
        verdict, why = self.verdict
        runs = self.runs
        total = len(runs)
        kinds = ("stopped", "left_area", "collided", "crashed", "not_finished", "failsafes")
        return {
            "qrsim": version("qrsim"),
            "operation": self.operation.operation,
            "at": self.operation.at,
            "verdict": verdict,
            "why": why,
            "complete": self.complete,
            "left_out": list(self.left_out),
            "runs": total,
            "first_seed": self.seed,
            "criteria": [asdict(row) for row in self.rows],
            "vehicles": [
                {"name": name, "planned_s": round(planned, 2)}
                for name, planned in zip(self.flights.names, self.flights.planned_s, strict=True)
            ],
            "shares": {kind: _share(int((runs[kind] > 0.0).sum()), total) for kind in kinds} if total else {},
            "quantiles": {name: found for name in QUANTILES if total and (found := _quantiles(runs, name))},
            "charge_cvar5": _cvar(runs["charge_end"]) if total else None,
            "wind_boundary": self.boundary.to_json() if self.boundary is not None else None,
            "faults": [each.to_json() for each in self.outcomes],
            "volumes": {**self.volumes.to_json(), "simulated_departure": self.departure()},
            "worst": [
                {"seed": int(runs.seeds[run]), "command": self.command(run), "recording": self.recordings.get(run)}
                for run in self.worst()
            ],
            "assumed": list(self.flights.assumed),
            "not_modelled": list(NOT_MODELLED),
        }


def _share(hits: int, total: int) -> Content:
    """Return a number of runs as a share of all, with its Wilson interval, as a dict for JSON."""
    low, high = wilson(hits, total)
    return {"runs": hits, "share": hits / total, "low": low, "high": high}


def _quantiles(runs: Runs, name: str) -> Content | None:
    """Return 5 %, 50 % and 95 % quantiles of a metric of the runs, with its unit; None without finite values."""
    values = runs[name][np.isfinite(runs[name])]
    if not len(values):
        return None
    low, median, high = (float(each) for each in np.quantile(values, [0.05, 0.5, 0.95]))
    return {"p5": low, "median": median, "p95": high, "unit": QUANTILES[name]}


def _cvar(values: NumpyArray) -> float | None:
    """Return the mean of the smallest 5 % of some values, the conditional value at risk; None without values."""
    known = np.sort(values[np.isfinite(values)])
    return float(known[: max(1, len(known) // 20)].mean()) if len(known) else None


def prepared(operation: OperationSpec, flights: Flights, folder: Path, seed: int) -> Brief:
    """Write the operation and scenario into a brief's folder; return the brief, which has no runs yet.

    Raises:
        OSError: they cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / "operation.yaml", operation.to_yaml().encode())
    write_atomically(folder / SCENARIO, dump_yaml(flights.content).encode())
    return Brief(operation, flights, folder, seed, Runs([], flights.names))


def fly(brief: Brief, stages: Sequence[str], flyer: Callable[[], Flyer]) -> None:
    """Fly the stages of a brief until its verdict or time limit, by ``flyer()``; after an interruption, call ``keep``.

    Args:
        brief: changed in place.
        stages: names.
        flyer: called once something has to be flown.
    """
    brief.sky = sky_of(brief.flights.scenario)
    _read_others(brief, stages)
    complete = True
    made = flyer()
    asked = [stage for stage in stages if stage != "faults" or brief.operation.faults]
    for number, stage in enumerate(asked):
        fits = made.allow(SHARES[stage] / sum(SHARES[each] for each in asked[number:]))
        # A stage that has runs already is read at least.
        if number and not fits and not any(brief.folder.glob(f"{stage}*.zarr")):
            brief.left_out = asked[number:]
            complete = False
            break
        if stage == "nominal":
            complete = _nominal(brief, made)
            if not complete:
                keep(brief)
            # What fails in the forecast needs no fault and no more wind.
            if overall(brief.nominal)[0] == "no-go":
                break
        elif stage == "faults":
            complete &= _faults(brief, made)
        else:
            complete &= _winds(brief, made, polar=len(stages) == 1)
    brief.complete = complete


def _read_others(brief: Brief, stages: Sequence[str]) -> None:
    """Read the runs that earlier commands stored in the brief's folder, of stages that ``stages`` does not name."""
    if "nominal" not in stages:
        _nominal(brief, None)
    if "faults" not in stages and brief.operation.faults and (brief.folder / f"{faults.NAME}.zarr").exists():
        _faults(brief, None)
    if "wind" not in stages and any(brief.folder.glob("wind*.zarr")):
        _winds(brief, None, polar=True)


def keep(brief: Brief) -> None:
    """Read the runs stored before an interruption into the brief; verdicts of the last interim analysis hold."""
    _read(brief, look=None)
    if brief.winds is not None:
        _winds(brief, None, polar=True)


def _read(brief: Brief, look: int | None) -> None:
    """Judge the nominal runs stored up to interim analysis ``look``; None: all runs, with the last verdicts kept."""
    stores = []
    starts = len(brief.flights.starts)
    for piece in pieces(brief.operation.criteria.p_loss):
        if look is not None and piece.look > look:
            break
        paths = [path for part in piece.parts(starts) if (path := _store(brief, part)).exists()]
        stores += paths
        if len(paths) < starts:
            break
    runs = Runs(stores, brief.flights.names)
    if look is not None or len(runs) > len(brief.runs):
        brief.runs = runs
        low = brief.operation.contingency.low_battery.at
        decided = {row.name: row for row in brief.nominal if row.verdict != "marginal"} if look is None else {}
        found = judge(runs, brief.operation.criteria, look, brief.operation.energy, low)
        brief.nominal = [decided.get(row.name, row) for row in found]


def _store(brief: Brief, part: Piece) -> Path:
    """Return the path of the store with the runs of one part of the nominal stage."""
    return brief.folder / f"{part.name}.zarr"


def _nominal(brief: Brief, flyer: Flyer | None) -> bool:
    """Fly the nominal stage up to a verdict, or without ``flyer`` only read its runs; return whether it has one."""
    for piece in pieces(brief.operation.criteria.p_loss):
        parts = piece.parts(len(brief.flights.starts))
        if flyer is None:
            stores = [path for part in parts if (path := _store(brief, part)).exists()]
            if len(Runs(stores, brief.flights.names)) < piece.runs:
                _read(brief, look=None)
                return False
        elif not all(flyer.fly(nominal_study(part, brief.operation, brief.flights, brief.seed)) for part in parts):
            return False
        _read(brief, piece.look)
        if not undecided(brief.nominal) and brief.precise():
            return True
    return False


def _faults(brief: Brief, flyer: Flyer | None) -> bool:
    """Fly the stage with faults, or without ``flyer`` only read its runs; return whether it is complete."""
    store, written = (brief.folder / f"{faults.NAME}{ending}" for ending in (".zarr", ".yaml"))
    if store.exists() and written.exists():
        # The times of its faults may be those of an earlier command, which knew fewer runs.
        study = parse_yaml(written.read_text("utf-8"), str(written), own=True)
    else:
        known = brief.runs["finished_s"]
        known = known[np.isfinite(known)]
        finished_s = float(np.median(known)) if len(known) else max(brief.flights.planned_s)
        study = faults.fault_study(brief.operation, brief.flights, finished_s, brief.seed)
    complete = flyer is None
    if flyer is not None:
        scenario = faults.fault_scenario(brief.operation, brief.flights)
        load_scenario(scenario, quiet=True)
        write_atomically(brief.folder / faults.SCENARIO, dump_yaml(scenario).encode())
        complete = flyer.fly({**study, "first_seed": brief.seed})
    brief.outcomes = faults.fault_outcomes(store, study)
    return complete


def _winds(brief: Brief, flyer: Flyer | None, polar: bool) -> bool:
    """Fly the stage with other winds (``polar``: all bearings), or without ``flyer`` only read it; return if done."""
    brief.winds = brief.winds or winds_of(brief.operation, brief.flights, brief.folder)
    reserve = brief.operation.criteria.reserve if brief.operation.energy else None
    brief.boundary, complete = boundary_of(brief.winds, reserve, brief.seed, brief.folder, flyer, polar)
    return complete


def record_worst(brief: Brief) -> None:
    """Fly the worst runs of a brief again and record them in its folder, unless they are recorded already.

    Raises:
        RunError: a run cannot be written.
    """
    for run in brief.worst():
        seed = int(brief.runs.seeds[run])
        folder = brief.folder / RECORDINGS / f"seed_{seed}"
        if not folder.exists():
            values = [assignment(path, value) for path, value in brief.runs.values_at(run).items()]
            record(
                load_scenario(str(brief.folder / SCENARIO), values, quiet=True), folder, seed=seed, precision="float32"
            )
        brief.recordings[run] = str(folder)


def exit_code(verdict: Verdict) -> int:
    """Return the exit code of a verdict: 0 go, 3 marginal, 1 no-go."""
    return {"go": 0, "marginal": 3, "no-go": 1}[verdict]
