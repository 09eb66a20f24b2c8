"""What 'qrsim identify' and 'qrsim discover' find: in simulated flights of known vehicles, and in the recordings.

Round trip: vehicles with constants of their own fly through wind and turbulence by random commands; their noisy logs
are identified, starting from the published constants, and the 95 % intervals are held against the truth.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from tests.studies.discover.flown_logs import DT, NOISE, pelican_log, random_steps

import qrsim
from evidence.recordings import data_folder
from qrsim.core.tree import replace
from qrsim.models.vehicles.quadrotor import THROTTLE_RAW_PER_UNIT, Quadrotor
from qrsim.models.vehicles.separate_quadrotor import SeparateQuadrotor
from qrsim.studies.discover.discovery import Discovery, discover, is_published
from qrsim.studies.flight_logs import FlightLog, read_log
from qrsim.studies.identify.constants import CONSTANTS, PITCH, constants_in
from qrsim.studies.identify.fit import Answer, Question, solve
from qrsim.studies.identify.identification import identify
from qrsim.studies.identify.problem import cut
from qrsim.studies.identify.scores import whiteness
from qrsim.studies.identify.verdicts import coloured_channels

DOC = "constants and laws found again in simulated flights; errors on held-out parts of the recordings"
SEED = 20261121
PARTS = ("recordings", "laws", "round_trip", "lagged")
VEHICLES, FLIGHT_S, HORIZON_S = 50, 40.0, 2.0
# Vehicles whose actuators lag behind commands by a first-order lag, which the equations do not have.
LAGGED, LAG_S = 20, 0.04
SPREAD = 0.4
HOVER = (0.25, 0.75)
HOVER_BATTERY_V = 11.0
WIND_20FT, HEIGHT = 4.0, 300.0
# Of discovering.
SEEDS, RECORDED_SEEDS, GENERATIONS, POPULATION = 10, 5, 12, 30
DRAWN = tuple(name for name in CONSTANTS if name not in (*PITCH, "mass"))

Floats = np.ndarray[Any, Any]


def draw_vehicles(count: int, rng: np.random.Generator) -> tuple[dict[str, Floats], int]:
    """Return the constants (count,) of vehicles that can hover, and how many were rejected."""
    published = Quadrotor()
    names = (*DRAWN, "mass")
    kept: list[Floats] = []
    rejected = 0
    while len(kept) < count:
        values = np.array([getattr(published, name) for name in names]) * rng.uniform(
            1 - SPREAD, 1 + SPREAD, len(names)
        )
        if hover_throttle(dict(zip(names, values, strict=True))) is None:
            rejected += 1
        else:
            kept.append(values)
    return dict(zip(names, np.array(kept).T, strict=True)), rejected


def hover_throttle(values: dict[str, float]) -> float | None:
    """Return the throttle that carries the weight, None where it is out of HOVER or the battery does not allow it."""
    weight = values["mass"] * 9.81
    if values["cvb0"] + values["cvb1"] * HOVER_BATTERY_V < 1.1 * weight:
        return None
    roots = np.roots([values["cth2"], values["cth1"], values["cth0"] - weight])
    real = [float(root.real) / THROTTLE_RAW_PER_UNIT for root in roots if abs(root.imag) < 1e-9]
    inside = [throttle for throttle in real if HOVER[0] <= throttle <= HOVER[1]]
    return inside[0] if inside else None


def commands(hover: float, rows: int, rng: np.random.Generator) -> Floats:
    """Return (rows, 5) commands that move every axis, meet the battery's ceiling, and now and then idle."""
    throttle = np.clip(hover + random_steps(rows, 0.12, (0.3, 1.2), rng), 0.0, 1.0)
    for at in range(200, rows - 100, 400):
        throttle[at : at + 30] = 1.0
        throttle[at + 30 : at + 50] = 0.03
    return np.stack(
        [
            random_steps(rows, 0.3, (0.3, 1.5), rng),
            random_steps(rows, 0.3, (0.3, 1.5), rng),
            throttle,
            random_steps(rows, 1.0, (0.5, 2.0), rng),
            np.linspace(12.0, 9.5, rows) + random_steps(rows, 0.3, (1.0, 4.0), rng).clip(-0.3, 0.0),
        ],
        axis=1,
    ).clip([-0.9, -0.9, 0.0, -4.5, 9.0], [0.9, 0.9, 1.0, 4.5, 12.0])


def fly(values: dict[str, Floats], asked: Floats, seed: int) -> dict[str, Floats]:
    """Fly all vehicles in one windy world by commands (n, rows, 5); return the truth before each, (n, rows, 3)."""
    count, rows = asked.shape[:2]
    fleet = {
        "vehicle": {"type": "pelican", **{name: column.tolist() for name, column in values.items()}},
        "vehicles": [[0.0, 300.0 * i - 150.0 * count, -HEIGHT] for i in range(count)],
        "controller": {"type": "attitude", "feed": "truth"},
        "limits": {"velocity": 100.0, "rate": 30.0, "yaw": 1000.0},
    }
    far = 1e5
    world = qrsim.make_world(
        fleets={"drawn": fleet},
        wind={"type": "log_shear", "speed_20ft": WIND_20FT, "wind_from_deg": 225.0},
        turbulence={"type": "dryden"},
        area={"type": "box", "x_min": -far, "x_max": far, "y_min": -far, "y_max": far, "z_min": -3000.0},
        duration=rows * DT,
        precision="float64",
    )
    flight = qrsim.Simulation(world, seed=seed)
    flight.reset()
    found: dict[str, list[Floats]] = {"angles": [], "rates": [], "velocity": []}
    for row in range(rows):
        truth = flight.truth
        found["angles"].append(truth.attitude)
        found["rates"].append(truth.rates_body)
        found["velocity"].append(truth.velocity_ned)
        flight.advance(asked[:, row])
    if not flight.valid.all():
        raise RuntimeError(f"a vehicle stopped: {flight.reasons}")
    return {name: np.stack(parts, axis=1) for name, parts in found.items()}


def logs_of(truth: dict[str, Floats], asked: Floats, delays: Floats, rng: np.random.Generator) -> list[FlightLog]:
    """Return a log of each vehicle: noise on what is measured, and commands logged some rows before they act."""
    sizes = {"angles": NOISE["angle"], "rates": NOISE["rate"], "velocity": NOISE["velocity"]}
    names = {
        "angles": ("roll", "pitch", "yaw"),
        "rates": ("roll_rate", "pitch_rate", "yaw_rate"),
        "velocity": ("velocity_north", "velocity_east", "velocity_down"),
    }
    logs = []
    for i, late in enumerate(delays):
        signals: dict[str, Floats] = {}
        for kind, size in sizes.items():
            noisy = truth[kind][i] + size * rng.standard_normal(truth[kind][i].shape)
            signals |= dict(zip(names[kind], noisy.T, strict=True))
        early = np.concatenate([asked[i, late:], np.repeat(asked[i, -1:], late, axis=0)])
        given = ("pitch_command", "roll_command", "throttle", "yaw_rate_command", "battery")
        signals |= dict(zip(given, early.T, strict=True))
        rows = DT * np.arange(len(early))
        logs.append(FlightLog(f"vehicle_{i}", Path(f"vehicle_{i}"), "simulated", DT, rows, signals))
    return logs


def lagged(asked: Floats, lag_s: float) -> Floats:
    """Return commands (n, rows, 5) as a first-order lag passes them on, the battery as it is."""
    if not lag_s:
        return asked
    keep = math.exp(-DT / lag_s)
    passed = asked.copy()
    for row in range(1, asked.shape[1]):
        passed[:, row, :4] = keep * passed[:, row - 1, :4] + (1.0 - keep) * asked[:, row, :4]
    return passed


def round_trip(count: int, flight_s: float, seed: int = SEED, lag_s: float = 0.0) -> dict[str, Any]:
    """Return how often the intervals hold the truth, and the bias, of each constant; commands may lag [s]."""
    rng = np.random.default_rng(seed)
    values, rejected = draw_vehicles(count, rng)
    rows = round(flight_s / DT)
    hovers = [hover_throttle({name: float(column[i]) for name, column in values.items()}) for i in range(count)]
    asked = np.stack([commands(hover or 0.5, rows, rng) for hover in hovers])
    delays = rng.integers(1, 4, count)
    logs = logs_of(fly(values, lagged(asked, lag_s), seed), asked, delays, rng)
    published = Quadrotor()
    start = {name: float(getattr(published, name)) for name in CONSTANTS if name not in PITCH}
    results: list[Answer] = []
    effective: list[set[str]] = []
    for i, log in enumerate(logs):
        question = Question((), start | {"mass": float(values["mass"][i])})
        piece = cut(log, HORIZON_S)
        names = constants_in(piece.channels, False)
        answer = solve(replace(question, constants=names), [piece])
        white = [whiteness(piece, answer.residuals[0])]
        results.append(answer)
        effective.append({name for name in answer.estimated if coloured_channels(name, False, white)})
    return {"vehicles": count, "rejected": rejected, **_coverage(results, values, delays, effective)}


def _coverage(
    results: list[Answer], values: dict[str, Floats], delays: Floats, effective: list[set[str]]
) -> dict[str, Any]:
    """Return, of each constant, in how many vehicles it was identified, and how those estimates lie about the truth."""
    constants: dict[str, Any] = {}
    total = inside_total = 0
    for name in DRAWN:
        found = [(i, r) for i, r in enumerate(results) if name in r.estimated]
        if not found:
            constants[name] = {"identified": 0}
            continue
        truth = np.array([values[name][i] for i, _ in found])
        estimate = np.array([r.values[name] for _, r in found])
        spans = np.array([r.covariance.interval(name) for _, r in found])
        inside = int(((spans[:, 0] <= truth) & (truth <= spans[:, 1])).sum())
        relative = (estimate - truth) / np.abs(truth)
        band = scipy.stats.binom.interval(0.95, len(found), 0.95)
        error = float(np.std(relative, ddof=1)) / math.sqrt(len(found)) if len(found) > 1 else 0.0
        constants[name] = {
            "identified": len(found),
            "covered": inside,
            "coverage_percent": 100.0 * inside / len(found),
            "band_low": int(band[0]),
            "band_high": int(band[1]),
            "effective": sum(name in effective[i] for i, _ in found),
            "bias_percent": 100.0 * float(np.mean(relative)),
            "bias_error_percent": 100.0 * error,
            "rms_error_percent": 100.0 * float(np.sqrt(np.mean(relative**2))),
            "half_width_percent": 100.0 * float(np.median(np.diff(spans, axis=1)[:, 0] / 2.0 / np.abs(truth))),
        }
        total, inside_total = total + len(found), inside_total + inside
    late = np.array([r.nuisances[0]["delay"] for r in results]) - DT * delays
    return {
        "constants": constants,
        "coverage_percent": 100.0 * inside_total / max(total, 1),
        "missed_unsaid": sum(
            _misses(r, values, i, name) and name not in effective[i]
            for i, r in enumerate(results)
            for name in r.estimated
            if name in DRAWN
        ),
        "delay_rms_error_ms": 1e3 * float(np.sqrt(np.mean(late**2))),
        "evaluations": float(np.median([r.evaluations for r in results])),
        "at_bounds": sum(bool(r.at_bounds) for r in results),
    }


def _misses(answer: Answer, values: dict[str, Floats], i: int, name: str) -> bool:
    """Return whether the interval of a constant does not hold the truth of vehicle i."""
    low, high = answer.covariance.interval(name)
    return not low <= float(values[name][i]) <= high


def _start(separate: bool) -> dict[str, float]:
    published = SeparateQuadrotor()
    return {name: float(getattr(published, name)) for name in CONSTANTS if separate or name not in PITCH}


def recordings(folder: Path, full: bool) -> dict[str, Any]:
    """Return the errors on the held-out 40 % of each recording, published and identified constants."""
    rotation = read_log(folder / "rotation_rig.csv")
    default, separate = Question((), _start(False)), Question((), _start(True), True)
    cases: dict[str, tuple[FlightLog, Question]] = {"rotation": (rotation, default)}
    if full:
        outdoor, thrust = read_log(folder / "outdoor_flight.csv"), read_log(folder / "thrust_rig.csv")
        cases |= {
            "rotation_separate": (rotation, separate),
            "rotation_no_delay": (rotation, Question((), _start(False), delay=0.0)),
            "thrust": (thrust, default),
            "thrust_no_delay": (thrust, Question((), _start(False), delay=0.0)),
            "outdoor": (outdoor, default),
        }
    return {name: _recording(log, question) for name, (log, question) in cases.items()}


def _recording(log: FlightLog, question: Question) -> dict[str, Any]:
    # Once to compile; the second has nothing left to compile.
    found = identify([log], question)
    if log.name == "rotation_rig":
        found = identify([log], question)
    scores = found.held_out[0]
    horizontal = [
        sum(scores[which].get(name, 0.0) for name in ("velocity_north", "velocity_east"))
        for which in ("start", "identified")
    ]
    constants = {name: {key: each[key] for key in ("value", "low", "high")} for name, each in found.constants().items()}
    return {
        "wall_s": found.wall_s,
        "delay_s": found.answer.nuisances[0]["delay"],
        "constants": constants,
        "held_out": {key: value for key, value in scores.items() if value},
        # Open loop from the first held-out row; that over horizons of 5 s is in velocity_5_s.
        **({"horizontal_lower_percent": 100.0 * (1.0 - horizontal[1] / horizontal[0])} if horizontal[0] else {}),
        "lag_1": {name: each["lag_1"] for name, each in found.whiteness[0].items()},
    }


def laws(seeds: int, folder: Path | None, generations: int, population: int) -> dict[str, Any]:
    """Return in how many seeds each published structure is found, and what is found in the rotation recording."""
    found = [discover(pelican_log(SEED + i), i, generations, population) for i in range(seeds)]
    result: dict[str, Any] = {
        "seeds": seeds,
        "generations": generations,
        "population": population,
        "found": {law: sum(is_published(each.laws[law]) for each in found) for law in ("thrust", "tilt", "yaw")},
        "all_three": sum(all(is_published(law) for law in each.laws.values()) for each in found),
        "nodes": {law: float(np.median([each.laws[law].chosen.size for each in found])) for law in found[0].laws},
    }
    if folder is not None:
        rotation = read_log(folder / "rotation_rig.csv")
        recorded = [discover(rotation, seed, generations, population) for seed in range(RECORDED_SEEDS)]
        result["rotation"] = _law_scores(recorded[0]) | {"seeds": _over_seeds([_law_scores(each) for each in recorded])}
    return result


def _law_scores(found: Discovery) -> dict[str, Any]:
    published, after = found.held_out["published"], found.held_out["discovered"]
    lower = {name: 100.0 * (1.0 - after[name] / published[name]) for name in published}
    return {
        "held_out": found.held_out,
        "delay_s": found.delay,
        "nodes": {name: law.chosen.size for name, law in found.laws.items()},
        "terms": {name: len(law.terms or {}) for name, law in found.laws.items()},
        "trims": found.trims,
        "mean_lower_percent": float(np.mean(list(lower.values()))),
        "lower_percent": lower,
    }


def _over_seeds(scores: list[dict[str, Any]]) -> dict[str, Any]:
    """Return how the scores of several seeds differ."""
    means = [each["mean_lower_percent"] for each in scores]
    worst = [min(each["lower_percent"].values()) for each in scores]
    return {
        "count": len(scores),
        "mean_lower_percent": {"least": min(means), "most": max(means)},
        "none_worse": sum(each >= 0.0 for each in worst),
        "worst_lower_percent": min(worst),
        "nodes_tilt": {
            "least": min(s["nodes"]["tilt"] for s in scores),
            "most": max(s["nodes"]["tilt"] for s in scores),
        },
    }


def run(full: bool, folder: Path | None = None, parts: tuple[str, ...] = PARTS) -> dict[str, Any]:
    """Return what the parts find; the small form has one vehicle of the round trip and only the rotation recording.

    Raises:
        RunError: no recordings.
    """
    folder = data_folder() if folder is None else folder
    results: dict[str, Any] = {}
    if "recordings" in parts:
        results["recordings"] = recordings(folder, full)
    if full and "laws" in parts:
        results["laws"] = laws(SEEDS, folder, GENERATIONS, POPULATION)
    if "round_trip" in parts:
        results["round_trip"] = round_trip(VEHICLES, FLIGHT_S) if full else round_trip(1, 16.0)
    if "lagged" in parts:
        vehicles, seconds = (LAGGED, FLIGHT_S) if full else (1, 16.0)
        results["lagged"] = {
            "lag_ms": 1e3 * LAG_S,
            "none": round_trip(vehicles, seconds),
            "lag": round_trip(vehicles, seconds, lag_s=LAG_S),
        }
    return results
