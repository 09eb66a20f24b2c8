"""Studies of a brief: which runs each part of the nominal stage has, and their flight until they or the time end."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qrsim.files import Content
from qrsim.files.atomic import write_atomically
from qrsim.files.yaml_text import dump_yaml
from qrsim.studies.brief.flights import Flights, bearing_deg, speed_20ft
from qrsim.studies.brief.operation import OperationSpec
from qrsim.studies.brief.statistics import FEWEST, first_look
from qrsim.studies.sweep.groups import Group, regrouped
from qrsim.studies.sweep.plan import Batch, Plan
from qrsim.studies.sweep.prepare import plan_of, plan_of_conditions, plan_of_numbers
from qrsim.studies.sweep.provenance import differences, versions
from qrsim.studies.sweep.store import Store
from qrsim.studies.sweep.study import load_study
from qrsim.studies.sweep.sweeping import sweep, sweep_here

SCENARIO = "scenario.yaml"
# Interval of the tracks [s], runs of a batch, and the share of runs that may not finish.
TRACK_S, BATCH, UNFINISHED = 2.0, 16, 0.05
MARGINS = ("fence_horizontal_min", "ceiling_min", "ground_min", "obstacle_min", "air_separation_min")
METRICS = (
    "stopped", "left_area", "collided", "crashed", "stopped_s", "stopped_leg", "stopped_vehicle",
    "not_finished", "finished_s", "down_s", "flown_s",
    "charge_end", "failsafes", "failsafe_s", "home_m", "in_the_air", "wind_max_m_s", "tracking_error_max_m",
    "gnss_horizontal_rms_m", "gnss_vertical_rms_m", "without_fix_s",
    *(f"{margin}_{part}" for margin in MARGINS for part in ("m", "at_s", "leg", "vehicle")),
)  # fmt: skip


@dataclass(frozen=True)
class Piece:
    """Runs of the nominal stage between two looks, or those of them with one start.

    Attributes:
        look: the look after it; 0: one for a no-go alone.
        first: number of its first run.
        runs: how many it has.
        start: number of its start in the window.
        starts: how many starts the window has.
    """

    look: int
    first: int
    runs: int
    start: int = 0
    starts: int = 1

    @property
    def name(self) -> str:
        """Name of this part of the nominal stage, for its study and store."""
        return f"nominal_{self.look}" if self.starts == 1 else f"nominal_{self.look}_{self.start}"

    @property
    def batch(self) -> int:
        """Number of runs in a batch, small enough for two workers to have a batch each."""
        return BATCH if self.starts == 1 else min(BATCH, -(-self.runs // 2))

    def parts(self, starts: int) -> list[Piece]:
        """Split this part of the nominal stage by start times, into nearly equal numbers of runs."""
        ends = [self.first + i * self.runs // starts for i in range(starts + 1)]
        return [Piece(self.look, ends[i], ends[i + 1] - ends[i], i, starts) for i in range(starts)]


def pieces(p_loss: float) -> Iterator[Piece]:
    """Yield the parts of the nominal stage, without end: the runs up to each interim analysis, doubling the total."""
    first = first_look(min(p_loss, UNFINISHED))
    done = 0
    if first > FEWEST:
        yield Piece(0, 0, FEWEST)
        done = FEWEST
    look, total = 1, first
    while True:
        yield Piece(look, done, total - done)
        done, total, look = total, 2 * total, look + 1


def varied(operation: OperationSpec, flights: Flights) -> Content:
    """Return the parameters that a nominal study varies, as its content: the wind, and parameters of every vehicle."""
    wind, factor, spec = flights.wind, speed_20ft(flights.wind), operation.uncertain
    found: Content = {}
    steady, speed = wind.file is None, wind.speed or 0.0
    if steady and wind.std > 0.0:
        low, high = (max(0.0, (speed + sign * 3.0 * wind.std) * factor) for sign in (-1.0, 1.0))
        found["world.wind.speed_20ft"] = {"low": low, "high": min(high, 50.0), "scale": "normal"}
    if steady and wind.from_std > 0.0:
        low, high = (bearing_deg(wind) + sign * 3.0 * wind.from_std for sign in (-1.0, 1.0))
        found["world.wind.wind_from_deg"] = {"low": low, "high": high, "scale": "normal"}
    for place in flights.places:
        fleet = flights.content["fleets"][place.fleet]
        numbers = {
            "battery.capacity": spec.battery_capacity,
            "vehicle.mass": spec.mass,
            "vehicle.drag_x": spec.drag,
            "vehicle.drag_y": spec.drag,
        }
        for path, share in numbers.items():
            part, key = path.split(".")
            value = float(np.ravel(fleet[part][key])[place.row])
            if share > 0.0 and value > 0.0:
                found[place.path(path)] = {"low": value * (1.0 - share), "high": value * (1.0 + share)}
        low, high = spec.initial_charge
        if low < high:
            found[place.path("battery.initial_charge")] = {"low": low, "high": high}
    return found


def nominal_study(piece: Piece, operation: OperationSpec, flights: Flights, seed: int) -> Content:
    """Return the content of a study of one part of the nominal stage: a Latin hypercube point for each run."""
    vary = varied(operation, flights)
    study: Content = {
        "name": piece.name,
        "description": f"Runs {piece.first} to {piece.first + piece.runs - 1} of the brief {operation.operation}.",
        "scenario": SCENARIO,
        "first_seed": seed + piece.first,
        "metrics": list(METRICS),
        "track": TRACK_S,
        "batch": piece.batch,
        **({"set": dict(flights.settings[piece.start])} if piece.starts > 1 else {}),
    }
    if not vary:
        place = flights.places[0]
        value = float(np.ravel(flights.content["fleets"][place.fleet]["vehicle"]["mass"])[place.row])
        return {**study, "vary": {place.path("vehicle.mass"): {"values": [value]}}, "seeds": piece.runs}
    seed = piece.look * piece.starts + piece.start
    sampling = {"type": "latin_hypercube", "points": piece.runs, "seed": seed, "paired": True}
    return {**study, "vary": vary, "sampling": sampling, "seeds": 1}


def other_versions(folder: Path) -> list[str]:
    """Return a line of text for each version in a folder's stores that differs from those of this process."""
    for path in sorted(folder.glob("*.zarr")):
        try:
            known = json.loads((path / "zarr.json").read_text("utf-8"))["attributes"]["versions"]
        except (OSError, ValueError, KeyError, TypeError):  # its own message follows when it is opened
            continue
        if found := differences(versions(), known):
            return found
    return []


class OutOfTimeError(Exception):
    """The time that the brief has is over."""


class Flyer:
    """Flies studies into the folder of a brief, until its time is over.

    Args:
        folder: of the brief.
        client: of Dask, None to fly in this process.
        minutes: that all studies together may take.
        told: called after each batch, with the study's name, and its episodes done and planned.
    """

    def __init__(self, folder: Path, client: object, minutes: float, told: Callable[[str, int, int], None]):
        self.folder, self.client, self.minutes, self.told = folder, client, minutes, told
        self.begun = time.monotonic()
        self._first: Plan | None = None
        self._groups: dict[str, Mapping[tuple[int, ...], Group]] = {}
        # Longest time to a batch, from the batch before or from the start of its study [s].
        self.batch_s = 0.0
        self.allow(1.0)

    def allow(self, part: float) -> bool:
        """Reserve a share of the remaining time for the next studies; return whether a batch of runs fits into it."""
        now, end = time.monotonic(), self.begun + 60.0 * self.minutes
        self.deadline = now + max(0.0, end - now) * part
        return end - now > self.batch_s

    def prepare(self, study: Content) -> Plan:
        """Write a study into the brief's folder, and return its plan.

        Raises:
            UsageError: values of it are not allowed.
        """
        path = self.folder / f"{study['name']}.yaml"
        write_atomically(path, dump_yaml(study).encode())
        loaded = load_study(str(path))
        if "sampling" not in study:
            conditions = any("conditions" in item for item in study["vary"].values())
            return plan_of_conditions(loaded) if conditions else plan_of(loaded)
        # All parts of the nominal stage vary the same numbers; each start of a window has its own sky and wind.
        start = str(loaded.content["start_time"])
        if self._first is None:
            self._first = plan_of_numbers(loaded)
            self._groups[start] = self._first.groups
        axes, precision = self._first.axes, loaded.spec.precision
        if start not in self._groups:
            groups = self._first.groups.items()
            self._groups[start] = {key: regrouped(group, loaded.content, axes, precision) for key, group in groups}
        return Plan(loaded, axes, (), self._groups[start])

    def fly(self, study: Content) -> bool:
        """Fly the missing batches of a study until the deadline; return whether it is complete.

        Raises:
            UsageError: the folder has a store of another study.
            RunError: it cannot be flown or written.
        """
        begun = time.monotonic()
        plan = self.prepare(study)
        store = Store(self.folder / f"{study['name']}.zarr", plan)
        done = sum(plan.batch(i).episodes for i, known in enumerate(store.done) if known)

        def progress(batch: Batch) -> None:
            """Report a flown batch; raises OutOfTimeError if the deadline has passed and batches are still missing."""
            nonlocal done, begun
            now = time.monotonic()
            self.batch_s, begun = max(self.batch_s, now - begun), now
            done += batch.episodes
            self.told(str(study["name"]), done, plan.episodes)
            if now > self.deadline and not store.done.all():
                raise OutOfTimeError

        try:
            if not store.done.all():
                if self.client is None:
                    sweep_here(plan, store, progress)
                else:
                    sweep(plan, store, self.client, progress)
        except OutOfTimeError:
            return False
        finally:
            store.close()
        return True
