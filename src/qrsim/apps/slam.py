"""``qrsim slam``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from qrsim.apps import SECONDS, check_seed, progress_bar
from qrsim.errors import RunError, UsageError, os_error_as
from qrsim.files import Content

if TYPE_CHECKING:
    from qrsim.studies.slam.estimate import Slam
    from qrsim.studies.slam.study import Study, Sweep


SWEPT = {"plain": "taken for white", "bias": "as a state"}
# Arms that are meant to converge.
CONVERGED = ("converged", "plain", "bias")


@dataclass(frozen=True)
class SlamCommand:
    """Show the effect of coloured GNSS noise on range-only SLAM: fly, estimate trajectory and landmarks, compare.

    A Pelican flies between random waypoints, once with the simulator's time-correlated GNSS errors and once with white
    ones of the same size. Ranges to ten unknown landmarks and the commands then give trajectory and landmarks, in one
    of two graphs. In 'paper', as published, GNSS is only where the iterations begin. In 'gnss' every fix is a factor,
    and the coloured error is also modelled as a state. See docs/explanation/slam.md for the equations and what to
    expect.

    Example:
      qrsim slam --seeds 10 --out slam
      qrsim slam --graph paper --noise both --seeds 50 --out slam_paper
      qrsim slam --run runs/first --out slam_first
      qrsim slam --vehicles 5 --states poses --duration 60 --out slam_team
    """

    graph: Literal["paper", "gnss"] = "gnss"
    """Use of GNSS: only for the start of the iterations, or as factors."""
    states: Literal["full", "poses"] = "full"
    """Unknown at each time: all 13 states of the model, or position and heading only, which is much faster."""
    noise: Literal["white", "coloured", "both"] = "both"
    """GNSS errors to fly with."""
    gnss: Literal["m8n", "f9p_single", "f9p_sbas", "f9p_rtk", "gps_2011"] | None = None
    """Receiver for the coloured errors (docs/howto/choose_a_receiver.md), instead of the published one."""
    seeds: int = 5
    """Number of flights with each kind of noise."""
    first_seed: int = 0
    """Seed of the first flight; the others follow."""
    duration: Annotated[float, SECONDS] = 120.0
    """Simulated time of each flight."""
    sweep: bool = False
    """Also fly with correlation times from white to 100 s, of equal variance, and draw the error against them."""
    run_folder: Annotated[
        Path | None, tyro.conf.arg(name="run", metavar="RUN", help_behavior_hint="(default: none)")
    ] = None
    """Use this recorded run instead of new flights."""
    code: bool = False
    """Load the Python files and modules that the recorded scenario names; only if you trust its author."""
    vehicle: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: the only one)")] = None
    """Vehicle of the run."""
    vehicles: int = 1
    """Number of vehicles that fly over the same landmarks, range to each other and are solved together; with --run, the
    first ones."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: no figures)")] = None
    """New or empty folder for figures and result.json."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> None:
        """Run ``qrsim slam``: fly, or read a run, estimate trajectory and landmarks, and report the errors."""
        self._check()
        if self.run_folder is not None:
            self._solve_run(self.run_folder)
        elif self.vehicles > 1:
            self._team()
        else:
            self._study()

    def _make_out(self) -> None:
        """Create the output folder, so that an unwritable one is reported before anything is flown."""
        if self.out is None:
            return
        with os_error_as(RunError, f"--out {self.out}"):
            self.out.mkdir(parents=True, exist_ok=True)

    def _check(self) -> None:
        """Raise UsageError for options that are out of range or do not go together."""
        if self.seeds < 1:
            raise UsageError(f"--seeds {self.seeds}: expected a positive number of flights")
        check_seed(self.first_seed, "--first-seed", self.seeds)
        if not 0.0 < self.duration <= 1e7:
            raise UsageError(f"--duration {self.duration:g}: expected a positive number of seconds, at most 10 000 000")
        from qrsim.studies.slam.team_report import check_together

        single = [name for name in ("noise", "sweep", "vehicle") if getattr(self, name) != getattr(SlamCommand, name)]
        check_together(self.vehicles, self.graph, self.run_folder is not None, single)
        if self.vehicle is not None and self.run_folder is None:
            raise UsageError("--vehicle: only with --run")
        if self.run_folder is not None:
            for name in ("noise", "gnss", "seeds", "first_seed", "duration", "sweep"):
                if getattr(self, name) != getattr(SlamCommand, name):
                    raise UsageError(f"--{name.replace('_', '-')}: not with --run, because its flight is recorded")
        if self.out is not None and self.out.is_dir() and any(self.out.iterdir()):
            raise UsageError(f"--out {self.out}: it exists and is not empty; choose another folder")
        if self.sweep and self.noise == "white":
            raise UsageError("--sweep: takes the size of the errors from coloured flights; leave out --noise white")

    def _solve_run(self, folder: Path) -> None:
        """Estimate trajectory and landmarks of a recorded run in ``folder``; print the errors and write the files."""
        from qrsim.runs import open_run
        from qrsim.runs.picture import save_picture
        from qrsim.studies.slam.estimate import from_run
        from qrsim.studies.slam.figures import draw_run

        self._make_out()
        if self.vehicles > 1:
            self._solve_together(folder)
            return
        run = open_run(folder, code=self.code)
        found = from_run(run, graph=self.graph, states=self.states, vehicle=self.vehicle)
        result = _of_run(found)
        if self.out is not None:
            save_picture(lambda: draw_run(found), self.out / "trajectory.png")
            _write(self.out / "result.json", result)
        if self.json:
            _print_json(result)
            return
        print(f"{found.flight.name}, graph {self.graph}, {len(found.time)} states\n")
        print(f"trajectory RMSE {_metres(result['trajectory_rmse_m'])} m")
        determined = f"of {int(found.determined.sum())} that are determined"
        print(f"landmark RMSE   {_metres(result['landmark_rmse_m'])} m, {determined}")
        if self.out is not None:
            print(f"\nfigure and numbers: {self.out}")

    def _solve_together(self, folder: Path) -> None:
        """Estimate several vehicles of a recorded run in one factor graph; print and draw the result."""
        from qrsim.runs import open_run
        from qrsim.studies.slam.team_report import solve_run_together, text_of_run

        found, result = solve_run_together(open_run(folder, code=self.code), self.vehicles, self.states)
        if self.out is not None:
            from qrsim.runs.picture import save_picture
            from qrsim.studies.slam.team_figures import draw_together

            save_picture(lambda: draw_together(found, str(folder)), self.out / "trajectory.png")
        self._report(result, text_of_run(found, result))

    def _team(self) -> None:
        """Fly a team with each seed, compare joint and separate estimates, print and draw them."""
        from qrsim.studies.slam.team_report import text_of_study
        from qrsim.studies.slam.team_study import CASES, compare

        self._make_out()
        seeds = range(self.first_seed, self.first_seed + self.seeds)
        with _progress(len(seeds) * len(CASES)) as progress:
            found = compare(seeds, self.vehicles, self.duration, states=self.states, gnss=self.gnss, progress=progress)
        flown = {"first_seed": self.first_seed, "duration_s": self.duration, "gnss": self.gnss}
        result = {**flown, **found.numbers()}
        if self.out is not None:
            from qrsim.runs.picture import save_picture
            from qrsim.studies.slam.team_figures import draw_gain, draw_together

            title = f"seed {self.first_seed}, errors of each vehicle's own, as states"
            save_picture(lambda: draw_together(found.together["own_as_own_states"][0], title), self.out / "team.png")
            save_picture(lambda: draw_gain(found), self.out / "gain.png")
        self._report(result, text_of_study(result))

    def _report(self, result: Mapping[str, object], text: str) -> None:
        """Write the numeric result next to the figures, and print it as ``text`` or JSON."""
        if self.out is not None:
            _write(self.out / "result.json", result)
        if self.json:
            _print_json(result)
            return
        print(text)
        if self.out is not None:
            print(f"\nfigures and numbers: {self.out}")

    def _study(self) -> None:
        """Fly with each seed and kind of noise, estimate, and print and draw the errors."""
        from qrsim.studies.slam import example
        from qrsim.studies.slam import study as studies
        from qrsim.studies.slam.estimate import BIAS_TIME_CONSTANT

        noises = studies.NOISES if self.noise == "both" else (self.noise,)
        seeds = range(self.first_seed, self.first_seed + self.seeds)
        # Coloured flights are always flown; those of a sweep come one kind after the other.
        studies.check_size(len(seeds), len({"coloured", *noises}) + self.sweep, self.duration, self.states)
        self._make_out()
        solves = len(seeds) * (len(noises) + (self.sweep and 1 + len(studies.TIME_CONSTANTS)))
        with _progress(solves) as progress:
            flights = studies.fly(seeds, noises, self.duration, gnss=self.gnss)
            how: dict[str, Any] = {"states": self.states, "progress": progress}
            memory = BIAS_TIME_CONSTANT if self.gnss is None else example.MEMORY[self.gnss]
            found = studies.study(self.graph, seeds, flights, bias_time_constant=memory, **how)
            swept = studies.sweep(seeds, flights, gnss=self.gnss, **how) if self.sweep else None
        flown = {"first_seed": self.first_seed, "duration_s": self.duration, "gnss": self.gnss}
        result = {"graph": self.graph, **flown, **studies.numbers(found)}
        if swept is not None:
            result["sweep"] = swept.numbers()
        if self.out is not None:
            _draw(found, swept, self.out)
            _write(self.out / "result.json", result)
        if self.json:
            _print_json(result)
        else:
            _print_study(result)
            if self.out is not None:
                print(f"\nfigures and numbers: {self.out}")


def _draw(found: Study, swept: Sweep | None, folder: Path) -> None:
    """Save a study's figures in a folder; ``swept``: results by correlation time of the GNSS error, if any."""
    from qrsim.runs.picture import save_picture
    from qrsim.studies.slam import figures

    save_picture(lambda: figures.draw_trajectories(found), folder / "trajectories.png")
    save_picture(lambda: figures.draw_allan(found), folder / "allan.png")
    if len(found.seeds) > 1:
        save_picture(lambda: figures.draw_errors(found), folder / "errors.png")
    if swept is not None:
        save_picture(lambda: figures.draw_sweep(swept), folder / "sweep.png")


def _of_run(found: Slam) -> Content:
    """Return the errors of a run's estimate as a dict for JSON, None for undefined ones."""
    import math

    import numpy as np

    places = [[None if math.isnan(axis) else axis for axis in place] for place in found.landmarks_ned.tolist()]
    rmse = found.landmark_rmse_m
    known = [bool(enough) for enough in ~np.isnan(found.landmarks_ned[:, 0])]
    spread = zip(found.landmarks_covariance.tolist(), known, strict=True)
    return {
        "run": found.flight.name,
        "graph": found.graph,
        "states": len(found.time),
        "iterations": found.iterations,
        "converged": found.converged,
        "trajectory_rmse_m": found.trajectory_rmse_m,
        "landmark_rmse_m": None if math.isnan(rmse) else rmse,
        "position_std_ned_m": np.sqrt(np.einsum("tii->ti", found.position_covariance)).tolist(),
        "landmarks_ned": places,
        "landmarks_covariance_m2": [rows if enough else None for rows, enough in spread],
        "determined": found.determined.tolist(),
        "ambiguous": found.mirrors.ambiguous.tolist(),
    }


def _print_study(result: Content) -> None:
    """Print a study's errors, paired tests and remedy."""
    from qrsim.studies.slam.estimate import MOST_ITERATIONS
    from qrsim.studies.slam.study import ARMS

    arms = ARMS[result["graph"]]
    count = f"{result['seeds']} flight{'s' if result['seeds'] > 1 else ''}"
    print(f"graph {result['graph']}, {count} of {result['duration_s']:g} s with each noise")
    determined = result["landmarks"]
    print(f"landmarks that the ranges determine: {determined['determined']} of {determined['all']}\n")
    print(f"  {'RMSE [m], mean over flights':<32} {'noise':<9} {'trajectory':>10} {'landmarks':>10}")
    for arm, meaning in arms.items():
        for noise, found in result["errors"].items():
            if arm in found:
                means = [_metres(found[arm][name].get("mean"), 10) for name in ("trajectory_m", "landmarks_m")]
                print(f"  {meaning:<32} {noise:<9} {means[0]} {means[1]}")
    left = sum(found[arm]["not_converged"] for found in result["errors"].values() for arm in found if arm in CONVERGED)
    if left:
        print(f"\n  not converged after {MOST_ITERATIONS} iterations: {left} of the solutions", end="")
    for arm, found in result["paired"].items():
        for name, test in ((name, test) for name, test in found.items() if test["pairs"]):
            what = f"{arms[arm]}, {name.removesuffix('_m')}"
            print(f"\n  {what}: coloured - white {_interval(test)} m, Wilcoxon p = {test['p']:.2g}", end="")
    if "remedy" in result:
        share = result["remedy"]["trajectory_m"]["recovered"]
        part = _interval(share, "part", 100.0)
        print(f"\n\n  the error as a state recovers {part} % of what the trajectory lost", end="")
    for noise, fixes in result["fixes"].items():
        if "allan" in fixes:
            slope = _interval(fixes["allan"], "slope")
            print(f"\n  {noise} fixes: slope of the Allan deviation, 0.4 to 10 s: {slope}", end="")
    for name, found in result.get("sweep", {}).items():
        means = [f"{found[arm]['mean']:.3f} m {how}" for arm, how in SWEPT.items() if arm in found]
        print(f"\n  correlation {name.removeprefix('tau_').replace('_', ' '):<7}{', '.join(means)}", end="")
    print()


def _metres(value: float | None, width: int = 8) -> str:
    """Return a length [m] as text ``width`` wide, a dash for None."""
    return f"{'-':>{width}}" if value is None else f"{value:{width}.3f}"


def _interval(found: dict[str, float], name: str = "mean", unit: float = 1.0) -> str:
    """Return a mean (``found[name]``) times the factor ``unit`` as text, with its 95 % interval if it has one."""
    if "low" not in found:
        return f"{unit * found[name]:.3g}"
    return f"{unit * found[name]:.3g} (95 %: {unit * found['low']:.3g} to {unit * found['high']:.3g})"


def _write(path: Path, result: Mapping[str, object]) -> None:
    """Write a result as a JSON file, complete or not at all; raises RunError if it cannot be written."""
    import json

    from qrsim.files.atomic import write_atomically

    with os_error_as(RunError, f"cannot write {path}"):
        write_atomically(path, (json.dumps(result, indent=2, allow_nan=False) + "\n").encode())


def _print_json(result: Mapping[str, object]) -> None:
    """Print the result of a study as JSON."""
    import json

    print(json.dumps(result, indent=2, allow_nan=False))


@contextmanager
def _progress(solves: int) -> Iterator[Callable[[], None]]:
    """Show a progress bar while the context lasts, on a terminal only; yield the function that counts one solved
    flight."""
    with progress_bar("flights solved", solves, "{task.completed:.0f} of {task.total:.0f}") as update:
        yield lambda: update(advance=1)
