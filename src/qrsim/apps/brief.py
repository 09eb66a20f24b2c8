"""``qrsim brief``."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from qrsim.apps import Repeated, progress_bar
from qrsim.errors import RunError, UsageError, os_error_as

if TYPE_CHECKING:
    from qrsim.studies.brief.briefing import Brief as Briefing
    from qrsim.studies.brief.flights import Flights
    from qrsim.studies.brief.operation import OperationSpec
    from qrsim.studies.brief.studying import Flyer

PAGE, PDF, NUMBERS, KML, OPERATION = "brief.html", "brief.pdf", "brief.json", "brief.kml", "operation.yaml"
PLANS = (".plan", ".waypoints", ".txt", ".kml", ".kmz", ".gpx", ".geojson", ".json")
# What a brief writes into its folder, and --again discards.
OWN = ("nominal_*", "faults*", "wind*", "runs", "brief.*", OPERATION)
# Seconds of vehicles that fly in a second, about.
USUAL_SPEED = 5000.0
# More vehicles need more than the default time.
MANY = 20


@dataclass(frozen=True)
class Brief:
    """Say go, marginal or no-go before a field day: fly plans many times in the forecast wind, and judge the margins.

    OPERATION is a .plan of QGroundControl, several, or an operation's .yaml file. Every run draws the wind within the
    error of its forecast, and numbers of the vehicles; faults follow. The folder briefs/NAME gets a page, its numbers
    as JSON, and the stores of all runs. The same command again continues where it stopped.

    Exit code 0: go; 1: no-go; 2: wrong usage; 3: marginal.

    Example:
      qrsim brief mission.plan --vehicle x500 --wind 7@250 --at 2026-05-01T10:00Z
      qrsim brief mission.plan --vehicle x500 --wind 14kn@250 --write operation.yaml
      qrsim brief operation.yaml --minutes 10
    """

    operation: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="OPERATION")]
    """Plans, or one operation's YAML file."""
    vehicle: Annotated[Repeated, tyro.conf.arg(metavar="NAME", help_behavior_hint="(for plans)")] = field(
        default_factory=list
    )
    """Model or .yaml file of the vehicle; PLAN=NAME for each plan, several times."""
    wind: Annotated[str | None, tyro.conf.arg(metavar="SPEED@FROM", help_behavior_hint="(for plans)")] = None
    """Forecast at 10 m, in m/s (or kn, km/h), and the bearing that it comes from, in degrees; or a weather file."""
    at: Annotated[str | None, tyro.conf.arg(metavar="TIME", help_behavior_hint="(default: now)")] = None
    """Start of the flights with its zone, such as 2026-05-01T10:00Z."""
    battery: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: 4 cells, 5 Ah)")] = None
    """YAML file with the numbers of every vehicle's pack."""
    no_energy: bool = False
    """Judge no charge."""
    stage: Annotated[Literal["nominal", "faults", "wind", "all"], tyro.conf.arg(metavar="STAGE")] = "all"
    """nominal, faults, wind (the limit in every direction), or all (of wind the forecast's direction)."""
    minutes: float = 3.0
    """Largest time for flying; the verdict may come earlier."""
    precision: Annotated[float | None, tyro.conf.arg(metavar="P", help_behavior_hint="(default: a verdict)")] = None
    """Fly on until the intervals of losses and of unfinished missions are narrower, such as 0.02."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: one for each core)")] = None
    """Processes to fly with; 1: this one."""
    seed: int = 0
    """Seed of the first run."""
    longest: Annotated[float, tyro.conf.arg(metavar="HOURS")] = 1.0
    """Longest mission [h]."""
    write: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Write the operation with all defaults to a YAML file, and fly nothing."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: briefs/NAME)")] = None
    """Folder of the brief."""
    again: bool = False
    """Discard what the folder has, and begin again."""
    kml: bool = False
    """Write the volumes of a risk assessment (SORA) as KML too."""
    record: bool = True
    """Record the worst three runs, for qrsim view; --no-record leaves them out."""
    json: bool = False
    """Print the JSON instead of the summary."""

    def run(self) -> int:
        """Run ``qrsim brief``: check the operation, fly it, write the page, print the verdict; return the exit code."""
        self._check()
        operation = self._operation()
        if self.write is not None:
            return self._write(operation)
        from qrsim.extras import require
        from qrsim.studies.brief.flights import flights_of

        # Those of terrain, weather and buildings are needed with such files only.
        require("brief", "qrsim brief", "distributed", "xarray", "zarr", "jinja2")
        flights = flights_of(operation, 3600.0 * self.longest)
        self._check_precision(flights)
        folder = self.out or Path("briefs") / operation.operation
        self._clear(folder, operation)
        return self._brief(operation, flights, folder)

    def _check(self) -> None:
        """Raise UsageError for an option out of its range."""
        if not self.operation:
            raise UsageError("OPERATION: missing; expected plans, or an operation's .yaml file")
        if not 0.0 < self.minutes <= 10_080.0:
            raise UsageError(f"--minutes {self.minutes:g}: allowed: above 0, at most 10080")
        if self.precision is not None and not 0.0 < self.precision < 1.0:
            raise UsageError(f"--precision {self.precision:g}: allowed: above 0, below 1 (2 % is 0.02)")
        if not 0.0 < self.longest <= 24.0:
            raise UsageError(f"--longest {self.longest:g}: allowed: above 0, at most 24 hours")
        if self.workers is not None and self.workers < 1:
            raise UsageError(f"--workers {self.workers}: expected a positive number")
        if not 0 <= self.seed < 2**62:
            raise UsageError(f"--seed {self.seed}: expected an integer from 0 to 2**62 - 1")

    def _operation(self) -> OperationSpec:
        """Return the operation (mission, vehicle, time, wind) that the options describe; notes an assumed time."""
        from qrsim.studies.brief.operation import FAULTS, checked, read_operation
        from qrsim.studies.brief.words import NEEDED, battery_of, now_rounded, time_of, vehicles_of

        files = [Path(name) for name in self.operation]
        changes: dict[str, object] = {} if self.at is None else {"at": time_of(self.at)}
        if self.wind is not None:
            changes["wind"] = self._wind()
        if self.no_energy:
            changes |= {"energy": False, "faults": [fault for fault in FAULTS if fault != "low_battery"]}
        if any(file.suffix in (".yaml", ".yml") for file in files):
            if len(files) > 1 or self.vehicle or self.battery:
                raise UsageError(f"{files[0]}: an operation's file is given alone, without --vehicle and --battery")
            return read_operation(files[0], changes)
        for file in files:
            if file.suffix.lower() not in PLANS:
                raise UsageError(f"{file}: expected a plan ({', '.join(PLANS)}), or an operation's .yaml file")
        if "wind" not in changes:
            raise UsageError(f"{files[0].stem}: {NEEDED}")
        if "at" not in changes:
            changes["at"] = now_rounded()
            print(f"no --at: the flights are at {changes['at']}, which decides the satellites", file=sys.stderr)
        vehicles = vehicles_of(files, self.vehicle)
        pack = {} if self.battery is None else {"battery": battery_of(self.battery)}
        missions = [{"plan": str(file), "vehicle": name, **pack} for file, name in zip(files, vehicles, strict=True)]
        name = "".join(letter if letter.isalnum() or letter in "_.-" else "_" for letter in files[0].stem).strip("_.-")
        return checked({"operation": name or "brief", "missions": missions, **changes}, str(files[0]))

    def _wind(self) -> dict[str, object]:
        """Return the wind that the options describe, as entries of the operation."""
        from qrsim.studies.brief.words import WEATHER_FILES, wind_of

        assert self.wind is not None
        if Path(self.wind).suffix.lower() in WEATHER_FILES:
            return {"file": self.wind}
        speed, bearing = wind_of(self.wind)
        if not self.wind.split("@")[0].replace(".", "").strip().isdigit():
            print(f"wind: {self.wind} is {speed:.1f} m/s", file=sys.stderr)
        return {"speed": round(speed, 3), "from_deg": bearing}

    def _write(self, operation: OperationSpec) -> int:
        """Write the operation as the YAML file of --write, with relative paths, and return exit code 0."""
        import os

        from qrsim.files.atomic import write_atomically
        from qrsim.files.yaml_text import dump_yaml, parse_yaml
        from qrsim.studies.brief.operation import with_paths

        assert self.write is not None
        if self.write.suffix not in (".yaml", ".yml"):
            raise UsageError(f"--write {self.write}: expected the name of a .yaml file")
        folder = self.write.parent.absolute()
        content = with_paths(parse_yaml(operation.to_yaml(), "operation"), lambda name: os.path.relpath(name, folder))
        text = dump_yaml(content)
        with os_error_as(RunError, f"cannot write {self.write}"):
            write_atomically(self.write, text.encode())
        print(f"operation: {self.write}\nto brief it: qrsim brief {self.write}")
        return 0

    def _check_precision(self, flights: Flights) -> None:
        """Raise UsageError for a --precision that needs far more runs than the time limit allows."""
        from qrsim.studies.brief.statistics import runs_for

        if self.precision is None:
            return
        runs = runs_for(self.precision)
        needed = runs * len(flights.names) * max(flights.planned_s) / USUAL_SPEED / 60.0
        if needed > self.minutes:
            raise UsageError(
                f"--precision {self.precision:g}: needs about {runs} runs, {needed:.0f} minutes; --minutes "
                f"{math.ceil(1.2 * needed)} allows it"
            )

    def _clear(self, folder: Path, operation: OperationSpec) -> None:
        """Empty the output folder with --again; otherwise raise UsageError if it holds another operation's results."""
        import shutil

        from qrsim.files.yaml_text import parse_yaml

        there = folder / OPERATION
        if folder.exists() and not there.exists() and any(folder.iterdir()):
            raise UsageError(f"{folder}: it exists and is no folder of a brief; --out another folder")
        if not there.exists():
            return
        if self.again:
            for path in (path for pattern in OWN for path in folder.glob(pattern)):
                shutil.rmtree(path) if path.is_dir() else path.unlink()
            return
        text = there.read_text("utf-8")
        if text == operation.to_yaml():
            self._refuse_other_versions(folder)
            return
        differs = [*_differing(parse_yaml(operation.to_yaml(), "operation"), parse_yaml(text, str(there)))]
        raise UsageError(
            f"{folder}: was made of another operation; --out another folder, or --again",
            *(f"  {line}" for line in differs[:6]),
        )

    def _refuse_other_versions(self, folder: Path) -> None:
        """Raise UsageError if the runs in a folder were written by other versions of the packages."""
        from qrsim.studies.brief.studying import other_versions

        if other := other_versions(folder):
            raise UsageError(
                f"{folder}: was flown with other versions; --again begins it again, or --out another folder",
                *(f"  {line}" for line in other),
            )

    def _brief(self, operation: OperationSpec, flights: Flights, folder: Path) -> int:
        """Fly and judge all stages of the operation and print the brief; return the verdict's exit code."""
        from qrsim.studies.brief.briefing import STAGES, exit_code, fly, keep, prepared, record_worst

        with os_error_as(RunError, f"{folder}: cannot write there"):
            brief = prepared(operation, flights, folder, self.seed)
        brief.precision = self.precision
        if not self.json:
            _print_flights(operation, flights)
        stages = STAGES if self.stage == "all" else (self.stage,)
        try:
            with ExitStack() as opened, _progress() as told:
                fly(brief, stages, lambda: self._flyer(opened, folder, told))
        except (KeyboardInterrupt, RunError) as error:
            keep(brief)
            try:
                self._tell(brief, folder)
            except RunError as other:
                raise RunError(*(error.args if isinstance(error, RunError) else ()), *other.args) from None
            raise
        if self.record:
            record_worst(brief)
        self._tell(brief, folder)
        return exit_code(brief.verdict[0])

    def _flyer(self, opened: ExitStack, folder: Path, told: Callable[[str, int, int], None]) -> Flyer:
        """Return the Flyer of the studies, with worker processes that ``opened`` ends; it calls ``told(study, done,
        planned)``."""
        from qrsim.engine.settings import available_cores
        from qrsim.studies.brief.studying import Flyer
        from qrsim.studies.sweep.cluster import workers_of

        workers = self.workers or available_cores()
        client = None if workers == 1 else opened.enter_context(workers_of(None, workers))
        return Flyer(folder, client, self.minutes, told)

    def _tell(self, brief: Briefing, folder: Path) -> None:
        """Write the briefing as a page and as JSON, and print the verdict."""
        import json

        from qrsim.files.atomic import write_atomically
        from qrsim.studies.brief.page import write_page
        from qrsim.studies.brief.pdf import write_pdf
        from qrsim.studies.brief.volumes import write_kml

        found = brief.to_json()
        text = json.dumps(found, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
        files = {NUMBERS: text.encode(), PAGE: write_page(brief).encode(), PDF: write_pdf(brief)}
        if self.kml:
            files[KML] = write_kml(brief.operation.operation, brief.flights.scenario, brief.volumes).encode()
        wrong = []
        for name, content in files.items():
            try:
                write_atomically(folder / name, content)
            except OSError as error:
                wrong.append(f"{folder / name}: cannot be written: {error.strerror or error}")
        if self.json:
            print(text, end="")
        else:
            _print_verdict(brief)
            if self.kml:
                print(f"volumes: {folder / KML}: {brief.volumes_text()}")
            if not wrong:
                print(f"page:    {folder / PAGE} and {PDF}\nnumbers: {folder / NUMBERS}")
        # The verdict is told all the same.
        if wrong:
            raise RunError(*wrong)


def _differing(mine: object, theirs: object, path: str = "") -> Iterator[str]:
    """Yield "path: mine, theirs" for each entry in which two operations, as nested dicts, differ."""
    if isinstance(mine, Mapping) and isinstance(theirs, Mapping):
        for key in dict.fromkeys([*mine, *theirs]):
            yield from _differing(mine.get(key), theirs.get(key), f"{path}.{key}".lstrip("."))
    elif mine != theirs:
        yield f"{path}: {mine!r:.60} here, {theirs!r:.60} there"


def _print_flights(operation: OperationSpec, flights: Flights) -> None:
    """Print the wind, each mission's planned duration and, for many vehicles, the expected computing time."""
    from qrsim.studies.brief.statistics import first_look

    wind = flights.wind
    blows = f"{wind.speed:.3g} m/s from {wind.from_deg:.3g} deg at {wind.height:g} m"
    print(f"{operation.operation}: {operation.at}, wind {blows}")
    for name, mission, planned in zip(flights.names, flights.missions, flights.planned_s, strict=True):
        print(f"  {name:<20} {mission.plan}, {mission.vehicle}: {planned:.0f} s planned")
    if len(flights.names) > MANY:
        each = len(flights.names) * max(flights.planned_s) / USUAL_SPEED
        runs = first_look(operation.criteria.p_loss)
        print(
            f"  runs of {len(flights.names)} vehicles take about {each:.0f} s each: {runs} need "
            f"{math.ceil(each * runs / 60.0)} min; --minutes gives more time, --stage nominal less work"
        )


def _print_verdict(brief: Briefing) -> None:
    """Print the verdict, the table of criteria, and the command that shows the worst run."""
    verdict, why = brief.verdict
    print(f"\n{verdict.upper()}: {why}\n")
    width = max((len(row.name) for row in brief.rows), default=0)
    for row in brief.rows:
        print(f"  {row.name:<{width}}  {row.verdict:<8}  {row.why}{'' if row.decides else ' (reported only)'}")
    if not brief.complete:
        print(f"\n{brief.missing_text()}; the same command goes on, and --minutes gives it more time")
    for run in brief.worst()[:1]:
        seen = f"qrsim view {brief.recordings[run]}" if run in brief.recordings else brief.command(run)
        print(f"\nto see the worst run: {seen}")


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show a progress bar while the context lasts, on a terminal only; yield its update function (study, runs done,
    planned)."""
    with progress_bar("starting", 1.0, "{task.completed:.0f} of {task.total:.0f} runs") as update:

        def told(study: str, done: int, planned: int) -> None:
            """Show a study's name and its number of runs done in the progress bar."""
            update(description=study, completed=done, total=planned)

        yield told
