"""A recorded run as frames."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import QrsimError, RunError, warn_user
from qrsim.models.gnss.fixes import OF_SATELLITES
from qrsim.runs import Run
from qrsim.runs.export.place import place_of
from qrsim.runs.layout import EVENTS, Event
from qrsim.runs.radio_columns import links_logged
from qrsim.runs.summary import NOT_A_STOP
from qrsim.runs.surroundings import surroundings_of
from qrsim.tasks.places import Places
from qrsim.view.columns import Columns, vector
from qrsim.view.details import RecordedDetails
from qrsim.view.frame import Cast, Frame, Links, cast_of
from qrsim.view.gnss_events import FAULTS
from qrsim.view.imagery import Imagery
from qrsim.view.paint import Paints
from qrsim.view.readings import Excerpts
from qrsim.view.reasons import as_shown, event_in_words
from qrsim.view.rebuilt import rebuilt
from qrsim.view.sky import Satellite, columns_of, satellites
from qrsim.view.truth import ANGLES, AXES
from qrsim.world.state import World

# How long before a time a receiver's last words are looked for [s].
SKY_S = 60.0
# Times at which places along the paths are looked up.
PATH_TIMES = 100


@dataclass(frozen=True)
class Member:
    """One of the runs of a page.

    Attributes:
        letter: that its vehicles have in front of their names; "": there is one run only.
        recording: of it.
        shift: how much later than it was flown it is shown [s].
        first: number of its first vehicle among those of all runs.
        offset: where its origin is (3,) in the frame of the first run [m].
    """

    letter: str
    recording: Recording
    shift: float = 0.0
    first: int = 0
    offset: Floats = field(default_factory=lambda: np.zeros(3))

    @property
    def end(self) -> float:
        """Last time [s] at which the run is shown."""
        return self.recording.end + self.shift


class Recording:
    """A recorded run, readable at any time.

    Args:
        run: what is read.
        over: the run over which it is shown, None: it is shown by itself. Over another one its wind, its
            links and its contents are not read.

    Raises:
        RunError: there is no flight in it, or it is damaged.

    Attributes:
        cast: who flew.
        world: what there was; None where the scenario cannot be built any more.
        time: (T,) times of the true states that are kept [s].
        shown: every so-many-th tick is shown.
        stops: events of vehicles that stopped, and the number of the vehicle.
        paints: quantities that can colour vehicles and paths.
        imagery: picture of the ground to show with it; None: none.
        notes: what the page says about the run, one line each.
    """

    def __init__(self, run: Run, over: Recording | None = None):
        self.run, self._over = run, over
        if "truth" not in run or f"position_ned.{AXES[0]}" not in run["truth"]:
            raise RunError(
                f"{run.folder}: no true positions (truth.position_ned) were recorded, so nothing can be shown"
            )
        position, attitude = (vector(run, "truth", *part) for part in (("position_ned", AXES), ("attitude", ANGLES)))
        valid = ("valid",) if "valid" in run["truth"] else None
        self._truth = Columns(run, "truth", {"position": position, "attitude": attitude, "valid": valid})
        if not len(self._truth.time):
            raise RunError(f"{run.folder}: not a single tick was recorded, so there is nothing to show")
        measured = {"fix": _fixes(run), "height": _heights(run)}
        wind = {name: vector(run, "wind", f"{name}_ned", AXES) for name in ("mean", "gust")} if over is None else {}
        self._measured = Columns(run, "measurements", measured)
        self._wind = Columns(run, "wind", wind)
        self.time, self.shown = self._truth.time, self._truth.stride
        numbers = {name: i for i, name in enumerate(run.vehicles)}
        self.stops = [(event, numbers[event.vehicle]) for event in _stops(run) if event.vehicle is not None]
        self.world, self.cast = self._surroundings()
        self._rebuilt = rebuilt(run, self.world) if over is None else None
        self._links = _links(run) if over is None else None
        self._excerpts = Excerpts(run)
        self.paints = Paints(run)
        self.imagery: Imagery | None = None
        self._details = RecordedDetails(run, self.stops)
        self._slots = columns_of(run["measurements"].columns()) if "measurements" in run else []

    @property
    def notes(self) -> list[str]:
        """A line of text if the run is still being written; [] otherwise."""
        running = self.run.info.state == "running"
        return [f"the run has not ended; shown up to {self.end:g} s, the last flush"] if running else []

    @property
    def end(self) -> float:
        """Time [s] of the last tick."""
        return float(self.time[-1])

    @property
    def title(self) -> str:
        """Name of the run's scenario."""
        return self.run.info.scenario

    @property
    def members(self) -> list[Member]:
        """The runs that the page shows: only this one."""
        return [Member("", self)]

    @cached_property
    def events(self) -> list[Event]:
        """Events of the run, with stops in words; [] if they were not recorded.

        Faults that begin or end after their vehicle has stopped are left out.
        """
        ends = {event.vehicle: event.time for event, _ in self.stops}
        every = self.run.events if EVENTS in self.run else []
        shown = [own for own in every if own.kind not in FAULTS or own.time <= ends.get(own.vehicle, math.inf)]
        return [as_shown(event, self._area) for event in shown]

    @property
    def _area(self) -> object:
        """The flight area of the run; None if it is not known."""
        return None if self.world is None else self.world.area

    @property
    def heading(self) -> str:
        """Title line of the page: scenario and seed of the run."""
        info, count = self.run.info, len(self.run.vehicles)
        return f"{info.scenario}, seed {info.seed}, {count} vehicle{'s' if count != 1 else ''}"

    def _surroundings(self) -> tuple[World | None, Cast]:
        """Return the recorded scenario's world and its scene's fixed content; no world, with a warning, if invalid."""
        start = self._truth.at("position", self.time[0])
        over = self._over
        # Of the same scenario nothing has to be built again.
        same = over is not None and over.run.vehicles == self.run.vehicles and _looks(over.run) == _looks(self.run)
        if over is not None and same:
            return over.world, replace(over.cast, start_ned=np.nan_to_num(start).astype(float), flown=self._flown())
        try:
            world = self.run.built().world(self.run.info.precision)
            cast = replace(cast_of(world, start, self._places()), flown=self._flown(), site=self._site())
            if cast.names == self.run.vehicles:
                return world, cast
            why = "its vehicles are others"
        except (QrsimError, OSError) as error:
            why = f"{error}"
        warn_user(
            f"{self.run.folder}: the recorded scenario cannot be built, so its area is not shown, nor persons, "
            f"plumes and air: {why}"
        )
        count = len(self.run.vehicles)
        starts = np.nan_to_num(start).astype(np.float64)
        return None, Cast(self.run.vehicles, np.zeros(count, int), starts, flown=self._flown(), site=self._site())

    def _site(self) -> tuple[float, float, float] | None:
        """Return (latitude [deg], longitude [deg], height [m]) of the origin; None if the scenario has none."""
        with suppress(RunError):
            latitude, longitude, height = place_of(self.run).geodetic(np.zeros(3)).tolist()
            return latitude, longitude, height
        return None

    def _flown(self) -> Floats:
        """Return positions (K, 3) NED [m] along all vehicles' flown paths, for the initial view."""
        times = self.time[:: 1 + len(self.time) // PATH_TIMES]
        return np.vstack([self._truth.at("position", float(time)) for time in times])

    def _places(self) -> Places | None:
        """Return the goals and other places of the run's task; None if it was no task."""
        scenario = self.run.scenario
        task = scenario.get("task") if isinstance(scenario, dict) else None
        known = isinstance(task, dict) and task.get("type", "none") != "none"
        return surroundings_of(self.run).places if known else None

    def frame(self, time: float) -> Frame:
        """Return what the page draws of the recorded run at a time [s]."""
        row = max(0, int(np.searchsorted(self.time, time + 1e-6, side="right")) - 1)
        now = float(self.time[row])
        valid = self._truth.at("valid", now)[..., 0]
        return Frame(
            now,
            self._truth.at("position", now),
            self._truth.at("attitude", now),
            self._estimate(now),
            self._measured.at("fix", now),
            self._wind.at("mean", now),
            self._wind.at("gust", now),
            ~(valid == 0.0),
            {i: self.why(event) for event, i in self.stops if event.time <= now + 1e-6},
            self._rebuilt.at(now) if self._rebuilt else None,
            self._links_at(now),
            cache(lambda: self._details.at(now)),
        )

    def _links_at(self, time: float) -> Links | None:
        """Return the recorded radio links at a time [s]; None if there are none."""
        if self._links is None:
            return None
        found = [self._links.at(f"link{k}", time) for k in range(len(self._links.names))]
        sender, error, outcome = (np.nan_to_num(np.stack([link[:, i] for link in found])) for i in range(3))
        return Links(sender.astype(int), error, outcome.astype(int))

    @property
    def modes(self) -> list[tuple[float, int, str]]:
        """Changes of failsafes' actions, in order: (time [s], vehicle number, text), "" when one ends."""
        return self._details.modes

    def why(self, event: Event) -> str:
        """Return in words why a vehicle has stopped, from the event that recorded it."""
        return event_in_words(event, self._area)

    def positions(self, times: Floats) -> Floats:
        """Return the true positions (K, n, 3) NED [m] at times (K,) [s]."""
        return self._truth.at("position", times)

    def estimates(self, times: Floats) -> Floats:
        """Return measured positions (K, n, 3) NED [m] at times (K,) [s]: from GNSS, with the barometer's height."""
        return self._estimate(times)

    def _estimate(self, times: object) -> Floats:
        """Return positions (..., n, 3) NED [m] of the first GNSS receiver, with the height of the first barometer."""
        estimate = self._measured.at("fix", times).copy()
        height = self._measured.at("height", times)[..., 0]
        estimate[..., 2] = np.where(np.isfinite(height), -height, estimate[..., 2])
        return estimate

    def sky(self, vehicle: int, time: float) -> list[Satellite]:
        """Return the satellites that a vehicle's receiver reported at a time [s]; [] without any."""
        if not self._slots:
            return []
        times, measured = self._excerpts.of(vehicle, "measurements", time - SKY_S, time)
        row = int(np.searchsorted(times, time + 1e-6, side="right")) - 1
        if row < 0:
            return []
        said = {name: np.array([measured[slot[name]][row] for slot in self._slots]) for name in OF_SATELLITES}
        return satellites(said) if np.isfinite(said["elevation"]).all() else []


def _looks(run: Run) -> object:
    """Return (fleet, vehicle type) of a run's scenario, to compare the vehicles' shapes; None if unknown."""
    fleets = run.scenario.get("fleets") if isinstance(run.scenario, dict) else None
    if not isinstance(fleets, dict):
        return None
    return [(name, fleet.get("vehicle") if isinstance(fleet, dict) else None) for name, fleet in fleets.items()]


def _links(run: Run) -> Columns | None:
    """Return the logged columns of radio links of a run; None if it has none."""
    names = run["measurements"].columns() if "measurements" in run else ()
    count = links_logged(names)
    each: dict[str, tuple[str, ...] | None] = {
        f"link{k}": tuple(f"radio.{part}.{k}" for part in ("sender", "error", "outcome")) for k in range(count)
    }
    return Columns(run, "measurements", each) if count else None


def _first(run: Run, ending: str) -> str | None:
    """Return what precedes ``ending`` in the name of the first measured quantity that has it; None without one."""
    columns = run["measurements"].columns() if "measurements" in run else ()
    return next((column.removesuffix(f".{ending}") for column in columns if column.endswith(f".{ending}")), None)


def _fixes(run: Run) -> tuple[str, ...] | None:
    """Return the columns of the position of the first sensor that reports one; None without such a sensor."""
    sensor = _first(run, "position_ned.x")
    return vector(run, "measurements", f"{sensor}.position_ned", AXES) if sensor else None


def _heights(run: Run) -> tuple[str, ...] | None:
    """Return the column of the height of the first sensor that reports one; None without such a sensor."""
    sensor = _first(run, "height")
    return (f"{sensor}.height",) if sensor else None


def _stops(run: Run) -> list[Event]:
    """Return the event of each vehicle that stopped during a run, one per vehicle."""
    if EVENTS not in run:
        return []
    found = {e.vehicle: e for e in reversed(run.events) if e.kind not in NOT_A_STOP and e.vehicle in run.vehicles}
    return list(found.values())
