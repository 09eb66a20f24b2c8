"""``qrsim run``."""

from __future__ import annotations

import gc
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from qrsim.apps import Duration, Repeated, check_seed, progress_bar, with_duration
from qrsim.errors import RunError, UsageError
from qrsim.extras import require
from qrsim.files.interruptions import word
from qrsim.view.flight import OFF, replay, shown, stay

if TYPE_CHECKING:
    from qrsim.runs import Run as RecordedRun
    from qrsim.runs.recorder import Pace
    from qrsim.runs.summary import VehicleSummary
    from qrsim.scenarios.scenario import Scenario
    from qrsim.simulation.injections import Injection
    from qrsim.view.live import LiveView

FIGURE = "figure.png"
MOST_EVENTS = 20
# Vehicles named in a line.
MOST_NAMED = 5
BASELINE = "baseline"


@dataclass(frozen=True)
class Run:
    """Fly a scenario, record it, and show what happened.

    Writes a run folder (Parquet logs, the resolved scenario, seed and versions, a figure) and prints a table. It has
    the distance flown, the tracking error (from the leg being flown), the GNSS error (reported minus true position at
    the time of the fix) and the worst wind. It also has the waypoints reached, and the reason if a vehicle stopped.
    Below it are the smallest separation of two vehicles and, for a task, the score, as in 'qrsim score'.

    Example:
      qrsim run
      qrsim run outdoor_patrol --seed 7 --duration 60
      qrsim run outdoor_patrol --set world.wind.speed_20ft=7 --set world.turbulence=still
      qrsim run my_scenario.yaml --out runs/first --json
      qrsim run keep_spot --policy my_policy.py:hover --policy-ticks 5
      qrsim run search_and_rescue/2D --policy baseline
      qrsim run outdoor_patrol --every 10 --every measurements=2
      qrsim run outdoor_patrol --inject faults.yaml
      qrsim run outdoor_patrol --view
    """

    scenario: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SCENARIO")] = "outdoor_patrol"
    """Name (see 'qrsim list') or YAML file."""
    seed: int = 0
    """Seed of all randomness."""
    duration: Duration = None
    """Simulated time."""
    set: Annotated[Repeated, tyro.conf.arg(metavar="PATH=VALUE")] = field(default_factory=list)
    """Change one value of the scenario; can be given several times."""
    inject: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Faults and changes of the weather to inject: a YAML list of entries with target, kind and at, such as
    {target: gnss, kind: 'off', at: 20, end: 30}; or the injections.yaml of a recorded run."""
    injectable: Annotated[Repeated, tyro.conf.arg(metavar="NAME|all")] = field(default_factory=list)
    """Let faults be injected on the page of --view: name of a sensor, rotors, battery, radio, body, or all; can be
    given several times."""
    out: Annotated[
        Path | None,
        tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: runs/SCENARIO-seedSEED-TIME)"),
    ] = None
    """Run folder to write; must not exist."""
    every: Annotated[Repeated, tyro.conf.arg(metavar="[STREAM=]N")] = field(default_factory=list)
    """Log every Nth tick of truth, measurements, commands, wind, or all of them; can be given several times. All events
    are kept."""
    policy: Annotated[str | None, tyro.conf.arg(metavar="MODULE:NAME", help_behavior_hint="(default: none)")] = None
    """Your policy: a function of a reading that returns a command or a set-point; MODULE may be a .py file. 'baseline'
    is that of the scenario's task; so is the policy.npz of 'qrsim train'. Both are called once per step of the task."""
    estimator: Annotated[str | None, tyro.conf.arg(metavar="MODULE:NAME", help_behavior_hint="(default: none)")] = None
    """Your estimator: a function of a reading that returns the state estimate for the controllers."""
    policy_ticks: int = 1
    """Number of ticks between calls of the policy."""
    realtime: bool = False
    """Fly at the speed of the wall clock instead of as fast as possible."""
    view: Literal["off", "now", "wait"] = "off"
    """Show the flight live in three dimensions on a page for a browser; its address is printed. The page sets the
    speed, at first that of the wall clock. Afterwards it is a replay of the run: in a terminal until Ctrl-C, otherwise
    while a browser shows it. '--view' alone is '--view now'; 'wait' starts the flight once a browser has opened the
    page."""
    view_port: Annotated[int, tyro.conf.arg(metavar="PORT")] = 8080
    """Port of the page; if it is in use, the next free one."""
    view_host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address of this machine that the page listens on. If it is not 127.0.0.1, the printed address has a token, which
    is needed to view and control the page; nothing is encrypted."""
    precision: Literal["float32", "float64"] = "float32"
    """Arithmetic."""
    no_figure: bool = False
    """Leave out the figure."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> None:
        """Run ``qrsim run``: check the scenario, fly it, and print a summary."""
        # Importing and compiling make many objects and no garbage worth looking for; ``fly`` turns this on again.
        gc.disable()
        try:
            self._run()
        finally:
            gc.unfreeze()
            gc.enable()

    def _run(self) -> None:
        """Check the options, fly the scenario, print the summary, and keep the page open."""
        from qrsim.apps.run.every import parse_every
        from qrsim.scenarios.scenario import load_scenario

        check_seed(self.seed)
        if self.policy_ticks != 1 and self.policy is None:
            raise UsageError(f"--policy-ticks {self.policy_ticks}: there is no --policy")
        if self.policy_ticks != 1 and self._of_task:
            who = "the baseline" if self.policy == BASELINE else "a learned policy"
            raise UsageError(f"--policy-ticks {self.policy_ticks}: {who} is called once per step of its task")
        scenario = load_scenario(self.scenario, with_duration(self.set, self.duration))
        injections: tuple[Injection, ...] = ()
        if self.injectable:
            if self.view == OFF:
                raise UsageError("--injectable: faults are injected on the page; add --view")
            from qrsim.links.shared.injectable import with_injectable

            scenario = with_injectable(scenario, self.injectable)
        if self.inject is not None:
            from qrsim.scenarios.injection_file import read_injections

            scenario, injections = read_injections(scenario, self.inject)
        every = parse_every(self.every)
        folder = self.out or _new_folder(scenario.name, self.seed)
        # The folder is checked before anything is compiled.
        if self.view != OFF:
            require("view", "--view")
        if folder.exists():
            raise UsageError(f"run folder {folder} exists and is never overwritten; choose another --out")
        with shown(self.view, self.view_port, self.view_host) as page:
            pace = self._fly(scenario, folder, every, page, injections)
            if page is not None:
                replay(page, folder)
            self._report(folder, pace)
            if page is not None:
                stay(page)

    @property
    def _of_task(self) -> bool:
        """True if --policy is one of the scenario's task: its baseline or a learned one."""
        if self.policy is None or self.policy == BASELINE:
            return self.policy is not None
        from qrsim.tasks.learned import is_policy_file

        return is_policy_file(self.policy)

    def _fly(
        self,
        scenario: Scenario,
        folder: Path,
        every: dict[str, int],
        page: LiveView | None,
        injections: tuple[Injection, ...],
    ) -> Pace:
        """Fly the scenario into a run folder; return its simulated and wall time and its late chunks. ``every``: stream
        -> ticks between rows."""
        from qrsim.runs.recorder import fly
        from qrsim.runs.waiting import waiting_since

        policy = estimator = None
        if self.policy is not None or self.estimator is not None:
            from qrsim.interface.policies import load_function
            from qrsim.scenarios.registry import made

            if self.policy is not None and not self._of_task:
                policy = load_function("policy", str(self.policy), (BASELINE,))
            if self.estimator is not None:
                estimator = made("estimator", self.estimator)
        policy_ticks = self.policy_ticks
        if self._of_task:
            from qrsim.apps.run.baseline import task_policy

            policy, policy_ticks = task_policy(scenario, str(self.policy), self.seed, self.precision)
        try:
            with _progress(scenario) as progress:
                return fly(
                    scenario,
                    folder,
                    seed=self.seed,
                    precision=self.precision,
                    every=every,
                    realtime=self.realtime,
                    policy=policy,
                    estimator=estimator,
                    policy_ticks=policy_ticks,
                    progress=progress,
                    view=page,
                    begun=waiting_since(),
                    injections=injections,
                )
        except KeyboardInterrupt as error:
            if folder.exists():
                print(f"{word(error)}; the log so far is in {folder}", file=sys.stderr)
            raise

    def _report(self, folder: Path, pace: Pace) -> None:
        """Print the summary of a run and draw its figure; raises RunError if drawing fails."""
        from qrsim.runs import open_run
        from qrsim.runs.summary import summarise

        recorded = open_run(folder)
        summaries = summarise(recorded)
        figure, failure = (None, None) if self.no_figure else _draw(recorded, folder / FIGURE)
        if self.json:
            _print_json(recorded, summaries, pace, folder, figure)
        else:
            self._print_result(recorded, summaries, pace, figure)
        if failure:
            raise failure

    def _print_result(
        self, recorded: RecordedRun, summaries: list[VehicleSummary], pace: Pace, figure: Path | None
    ) -> None:
        """Print the table of vehicles, the real-time factor, and the paths of run folder and figure."""
        _print_table(recorded, summaries)
        factor = f"{pace.real_time_factor:.0f} times real time" if not self.realtime else "real time"
        print(f"{pace.simulated_s:g} s flown in {pace.wall_s:.2f} s ({factor}), start-up {pace.start_up_s:.1f} s")
        if pace.overruns:
            print(f"{pace.overruns} chunks were late: this machine is too slow for real time here")
        if recorded.info.every:
            kept = ", ".join(f"{stream} {number}" for stream, number in recorded.info.every.items())
            print(f"logged every Nth tick: {kept}; the table covers these ticks")
        if recorded.info.score is not None:
            from qrsim.runs.summary import score_text

            print(f"score:      {score_text(recorded.info.score)}")
        print(f"run folder: {recorded.folder}")
        if figure:
            print(f"figure:     {figure}")


def _draw(recorded: RecordedRun, path: Path) -> tuple[Path | None, RunError | None]:
    """Draw a run's figure; return its path, or the error, so that the numbers are printed all the same."""
    from qrsim.runs.figure import save_figure

    try:
        save_figure(recorded, path)
    except RunError as error:
        return None, error
    return path, None


def _new_folder(name: str, seed: int) -> Path:
    """Return a path runs/NAME-seedN-TIME at which nothing exists yet."""
    from datetime import datetime

    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    base = Path("runs") / f"{name}-seed{seed}-{stamp}"
    folder, number = base, 1
    while folder.exists():
        number += 1
        folder = base.with_name(f"{base.name}-{number}")
    return folder


@contextmanager
def _progress(scenario: Scenario) -> Iterator[Callable[[float, float], None]]:
    """Show a progress bar with the real-time factor in the context, on a terminal only; yield its update function
    (simulated, wall time [s])."""
    texts = "{task.completed:.0f} of {task.total:g} s", "{task.fields[factor]}"
    with progress_bar(scenario.name, scenario.duration, *texts, factor="compiling") as update:
        yield lambda simulated_s, wall_s: update(
            completed=simulated_s, factor=f"{simulated_s / max(wall_s, 1e-9):.0f} x real time"
        )


# Each heading in lines, as narrow as its numbers: with names of up to 17 letters the table has 80 columns.
HEADINGS = ("flown\n[m]", "tracking\nRMS [m]", "GNSS\nhor. [m]", "GNSS\nvert. [m]", "wind max\n[m/s]", "way-\npoints")
LEGEND = """tracking: distance from the leg being flown; GNSS: reported minus true position
at the time of the fix, RMS over the fixes; wind max: gusts included."""


def _print_table(recorded: RecordedRun, summaries: list[VehicleSummary]) -> None:
    """Print a table with a row for each vehicle: distance, errors, wind, waypoints, and when it stopped."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from qrsim.runs.separation import smallest_separation
    from qrsim.runs.summary import NOT_A_STOP

    stops = [event for event in recorded.events if event.kind not in NOT_A_STOP]
    stopped_at = {event.vehicle: f"{event.time:.2f}" for event in reversed(stops)}
    table = Table(box=SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
    # As Text, because in a plain string rich takes [m] for a style.
    table.add_column(Text("\nvehicle"), overflow="fold")
    for heading in (*HEADINGS, "stopped\nat [s]"):
        table.add_column(Text(heading), justify="right", no_wrap=True)
    for row in summaries:
        errors = (row.tracking_error_rms_m, row.gnss_horizontal_rms_m, row.gnss_vertical_rms_m)
        cells = [_number(row.distance_m, 1), *map(_number, errors), _number(row.worst_wind_m_s, 1), str(row.waypoints)]
        table.add_row(Text(row.vehicle), *cells, stopped_at.get(row.vehicle, "-"))
    print(f"{recorded.info.scenario}, seed {recorded.info.seed}\n")
    console = Console()
    # Below 80 columns the terminal breaks the lines, and no number is lost; a file has no width.
    console.width = max(console.width, 80) if console.is_terminal else 200
    with console.capture() as captured:  # printed here, because rich ends the process where the reader is gone
        console.print(table)
    print(f"{captured.get()}\n{LEGEND}")
    for line in _worst(summaries):
        print(line)
    nearest = smallest_separation(recorded)
    if nearest is not None:
        print(nearest.text)
    _print_events(recorded)


def _worst(summaries: list[VehicleSummary]) -> Iterator[str]:
    """Yield a line each on the largest height error, the lowest battery charge and the failsafes, as far as there are
    any."""
    heights = [row for row in summaries if math.isfinite(row.height_error_rms_m)]
    if heights:
        row = max(heights, key=lambda each: each.height_error_rms_m)
        yield f"height: RMS {row.height_error_rms_m:.2f} m from that of the waypoint, at most, of {row.vehicle}"
    charged = [row for row in summaries if math.isfinite(row.charge_least)]
    if charged:
        row = min(charged, key=lambda each: each.charge_least)
        lasts = f"; in the air it lasts {row.endurance_s / 60.0:.1f} min in all" if row.endurance_s > 0.0 else ""
        yield f"battery: {100.0 * row.charge_least:.0f} % left, at least, of {row.vehicle}{lasts}"
    flown = [row.vehicle for row in summaries if row.failsafes]
    if flown:
        more = f" and {len(flown) - MOST_NAMED} more" if len(flown) > MOST_NAMED else ""
        yield f"failsafes: {sum(row.failsafes for row in summaries)}, of {', '.join(flown[:MOST_NAMED])}{more}"


def _print_events(recorded: RecordedRun) -> None:
    """Print a run's events that went wrong or recovered, without reached waypoints."""
    notable = [event for event in recorded.events if event.kind not in ("waypoint_reached", "command_clipped")]
    for event in notable[:MOST_EVENTS]:
        print(event.message)
    if len(notable) > MOST_EVENTS:
        print(f"... and {len(notable) - MOST_EVENTS} more, in the run folder's events")


def _number(value: float, digits: int = 2) -> str:
    """Return a number as text with ``digits`` decimals, "-" if it is not finite."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def _print_json(
    recorded: RecordedRun, summaries: list[VehicleSummary], pace: Pace, folder: Path, figure: Path | None
) -> None:
    """Print the result of a run as JSON."""
    import json
    from dataclasses import asdict

    from qrsim.runs.separation import smallest_separation

    nearest = smallest_separation(recorded)
    result: dict[str, object] = {
        "scenario": recorded.info.scenario,
        "seed": recorded.info.seed,
        "precision": recorded.info.precision,
        "every": dict(recorded.info.every),
        "run": str(folder),
        "figure": str(figure) if figure else None,
        "simulated_s": pace.simulated_s,
        "wall_s": round(pace.wall_s, 6),
        "start_up_s": round(pace.start_up_s, 6),
        "first_tick_unix_s": round(pace.first_tick_unix_s, 6),
        "real_time_factor": round(pace.real_time_factor, 3),
        "overruns": pace.overruns,
        "score": recorded.info.score,
        "separation": None if nearest is None else nearest.to_json(),
        "vehicles": [summary.to_json() for summary in summaries],
        "events": [asdict(event) for event in recorded.events],
    }
    try:
        print(json.dumps(result, indent=2, allow_nan=False))
    except ValueError:
        raise RunError(f"{folder}: an event holds a value that is not finite, which JSON cannot represent") from None
