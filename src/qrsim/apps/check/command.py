"""``qrsim check``."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from qrsim.apps import Duration, Repeated, check_seed, progress_bar, with_duration
from qrsim.errors import RunError, UsageError

if TYPE_CHECKING:
    from qrsim.apps.check.outcomes import Moment, Outcome
    from qrsim.scenarios.scenario import Scenario
    from qrsim.simulation.rollout import Rollout

MOST_SEEDS = 6


@dataclass(frozen=True)
class Check:
    """Fly a scenario with many seeds and report failures: how often, with which seeds, when and where.

    For the day before a field day. A run fails if any vehicle leaves the area, collides, runs out of battery, breaks a
    state limit or loses GNSS. Prints the fraction of these runs with the exact 95 % interval, and the narrowest margins
    over all runs. For estimators with a covariance, also the actual errors compared with it. 'qrsim run SCENARIO --seed
    S' flies one of the runs again.

    Exit code 0: no run failed; 1: at least one did.

    Example:
      qrsim check outdoor_patrol --seeds 100
      qrsim check my_field_day.yaml --seeds 1000 --set world.wind.speed_20ft=8 --out worst.png
    """

    scenario: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SCENARIO")]
    """Name (see 'qrsim list') or YAML file."""
    seeds: int = 100
    """Number of runs."""
    first_seed: int = 0
    """Seed of the first run; the others follow."""
    duration: Duration = None
    """Simulated time."""
    set: Annotated[Repeated, tyro.conf.arg(metavar="PATH=VALUE")] = field(default_factory=list)
    """Change one value of the scenario; can be given several times."""
    policy: Annotated[str | None, tyro.conf.arg(metavar="MODULE:NAME", help_behavior_hint="(default: none)")] = None
    """Your policy: a function of a reading; under jax.jit it is compiled into the loop. Or the policy.npz of
    'qrsim train', for the task of the scenario."""
    estimator: Annotated[str | None, tyro.conf.arg(metavar="MODULE:NAME", help_behavior_hint="(default: none)")] = None
    """Your estimator: a function of a reading that returns the state estimate for the controllers."""
    policy_ticks: int = 1
    """Number of ticks between calls of the policy."""
    cores: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: all)")] = None
    """Cores to spread the runs over."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Draw the positions of failures (png, pdf or svg)."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Run ``qrsim check``: fly the scenario with several seeds and print the outcomes; return the exit code."""
        from qrsim.apps.check.outcomes import outcomes

        if self.seeds < 1:
            raise UsageError(f"--seeds {self.seeds}: expected a positive number of runs")
        if self.policy_ticks != 1 and self.policy is None:
            raise UsageError(f"--policy-ticks {self.policy_ticks}: there is no --policy")
        check_seed(self.first_seed, "--first-seed", self.seeds)
        if self.out is not None:
            _check_picture(self.out)
        self._use_cores()
        scenario = self._scenario()
        flown, wall_s = self._fly(scenario)
        found = outcomes(flown)
        failure = None if self.out is None else _draw(scenario, flown, found, self.out)
        self._report(scenario, flown, found, wall_s, None if failure else self.out)
        if failure:
            raise failure
        return 1 if found[-1].runs else 0

    def _use_cores(self) -> None:
        """Limit the number of processor cores that JAX uses to --cores, by default all; raises UsageError below 1."""
        from contextlib import suppress

        from qrsim.engine.settings import available_cores, configure

        if self.cores is not None:
            if self.cores < 1:
                raise UsageError(f"--cores {self.cores}: expected a positive number")
            configure(cpu_devices=self.cores)
            return
        # Called from Python, JAX may have started already, and the runs then go over the devices there are.
        with suppress(UsageError):
            configure(cpu_devices=available_cores())

    def _scenario(self) -> Scenario:
        """Load the scenario, with the changes of --set and --duration."""
        from qrsim.scenarios.scenario import load_scenario

        return load_scenario(self.scenario, with_duration(self.set, self.duration))

    def _policy(self, scenario: Scenario) -> tuple[object, int]:
        """Return the policy of --policy (None without one) and the number of ticks between its calls."""
        from qrsim.envs.learned import rollout_policy
        from qrsim.interface.policies import load_function
        from qrsim.tasks.learned import is_policy_file

        if self.policy is None or not is_policy_file(self.policy):
            return None if self.policy is None else load_function("policy", self.policy), self.policy_ticks
        if self.policy_ticks != 1:
            said = f"--policy-ticks {self.policy_ticks}: a learned policy is called once per step of its task"
            raise UsageError(said)
        learned = rollout_policy(self.policy, scenario)
        return learned, learned.ticks

    def _fly(self, scenario: Scenario) -> tuple[Rollout, float]:
        """Fly the scenario with every seed; return the rollout and the wall time [s]."""
        import time

        from qrsim.interface.mission_metrics import MISSION_METRICS
        from qrsim.scenarios.registry import made
        from qrsim.simulation.rollout import rollout

        missions = any(fleet.guidance.type == "mission" for fleet in scenario.spec.fleets.values())
        policy, policy_ticks = self._policy(scenario)
        functions: dict[str, Any] = {
            "policy": policy,
            "estimator": made("estimator", self.estimator),
            # A run whose missions are over ends before its duration.
            "metrics": MISSION_METRICS if missions and self.policy is None else None,
        }
        begun = time.perf_counter()
        with _progress(scenario, self.seeds) as progress:
            flown = rollout(
                scenario.world(),
                ticks=scenario.ticks,
                seeds=range(self.first_seed, self.first_seed + self.seeds),
                policy_ticks=policy_ticks,
                progress=progress,
                site=scenario.site,
                **functions,
            )
        return flown, time.perf_counter() - begun

    def _report(
        self, scenario: Scenario, flown: Rollout, found: list[Outcome], wall_s: float, picture: Path | None
    ) -> None:
        """Print outcomes, margins and estimator consistency of all runs, as text or JSON."""
        from qrsim.apps.check.consistency import consistency, print_consistency
        from qrsim.apps.check.outcomes import UNFINISHED, margins

        narrow, consistent = margins(flown), consistency(flown)
        simulated = float(scenario.duration * self.seeds)
        if "finished" in flown.metrics:
            simulated = float(flown["flown_s"].max(axis=1).sum())
        if self.json:
            import json
            from dataclasses import asdict

            result: dict[str, object] = {
                "scenario": scenario.name,
                "runs": self.seeds,
                "first_seed": self.first_seed,
                "duration_s": scenario.duration,
                "wall_s": round(wall_s, 3),
                "outcomes": [outcome.to_json() for outcome in found],
                "margins": {name: {**asdict(moment), "unit": unit} for name, (moment, unit) in narrow.items()},
                "consistency": [row.to_json() for row in consistent],
                "picture": str(picture) if picture else None,
            }
            print(json.dumps(result, indent=2))
            return
        print(f"{scenario.name}: {self.seeds} runs of {scenario.duration:g} s, {len(flown.vehicles)} vehicles\n")
        _print_outcomes(found, self.seeds)
        print("\nnarrowest margins over all runs")
        width = max(32, *map(len, narrow))
        for name, (moment, unit) in narrow.items():
            print(f"  {name:<{width}} {moment.value:8.2f} {unit if unit != '1' else '':<4} {_where(moment)}")
        print_consistency(consistent)
        print(
            f"\n{simulated:g} s flown in {wall_s:.1f} s, compiling included ({simulated / wall_s:.0f} times real time)"
        )
        if any(outcome.name == UNFINISHED and outcome.runs == self.seeds for outcome in found):
            print(f"no run finished its mission in {scenario.duration:g} s; a longer --duration may be enough")
        worst = found[-1].worst
        if worst is not None:
            again = ["qrsim", "run", self.scenario, "--seed", str(worst.seed)]
            again += [word for assignment in self.set for word in ("--set", assignment)]
            again += [] if self.duration is None else ["--duration", f"{self.duration:g}"]
            again += [] if self.policy is None else ["--policy", self.policy]
            again += [] if self.estimator is None else ["--estimator", self.estimator]
            again += [] if self.policy_ticks == 1 else ["--policy-ticks", str(self.policy_ticks)]
            print(f"to fly the first failed run again: {shlex.join(again)}")
        if picture:
            print(f"picture: {picture}")


def _draw(scenario: Scenario, flown: Rollout, found: list[Outcome], path: Path) -> RunError | None:
    """Draw the picture of a check; return an error (None: it is drawn) instead of raising it, so that the numbers are
    printed all the same."""
    from qrsim.apps.check.picture import save_picture

    try:
        save_picture(scenario, flown, found, path)
    except RunError as error:
        return error
    return None


def _print_outcomes(found: list[Outcome], runs: int) -> None:
    """Print a table with a row for each outcome: number of runs, interval, seeds and worst place."""
    width = max(len(outcome.name) for outcome in found)
    print(f"  {'in a run, any vehicle ...':<{width + 6}} {'runs':>5} {'fraction':>9}   95 % interval")
    for outcome in found:
        interval = f"{100 * outcome.low:5.1f} to {100 * outcome.high:5.1f} %"
        print(f"  {outcome.name:<{width + 6}} {outcome.runs:>5} {100 * outcome.fraction:>7.1f} %   {interval}")
        if outcome.worst is not None and outcome is not found[-1]:
            more = f" and {len(outcome.seeds) - MOST_SEEDS} more" if len(outcome.seeds) > MOST_SEEDS else ""
            print(
                f"      seeds {', '.join(map(str, outcome.seeds[:MOST_SEEDS]))}{more}; first: {_where(outcome.worst)}"
            )


def _where(moment: Moment) -> str:
    """Return the seed, vehicle, time and place of an outcome or margin as text."""
    north, east, down = moment.position_ned
    place = f"north {north:.1f}, east {east:.1f}, height {-down:.1f} m"
    return f"seed {moment.seed}, {moment.vehicle}, {moment.time_s:.2f} s, {place}"


def _check_picture(path: Path) -> None:
    """Raise UsageError, before anything is flown, for a picture's path that cannot be written."""
    from qrsim.errors import did_you_mean

    formats = ("png", "pdf", "svg")
    suffix = path.suffix.lstrip(".").lower()
    if suffix not in formats:
        raise UsageError(f"--out {path}: '{suffix}' is no picture{did_you_mean(suffix, formats)}")
    if not path.parent.is_dir():
        raise RunError(f"--out {path}: there is no folder {path.parent}")


@contextmanager
def _progress(scenario: Scenario, runs: int) -> Iterator[Callable[[int], None]]:
    """Show a progress bar with the real-time factor in the context, on a terminal only; yield a function that adds
    ticks to it."""
    import time

    begun, ticks = time.perf_counter(), 0
    texts = "{task.percentage:.0f} %", "{task.fields[factor]}"
    with progress_bar(scenario.name, scenario.ticks * runs, *texts, factor="compiling") as update:

        def show(done: int) -> None:
            """Add ticks to the progress bar and update the real-time factor."""
            nonlocal ticks
            ticks += done
            factor = ticks * scenario.spec.time_step / max(time.perf_counter() - begun, 1e-9)
            update(completed=ticks, factor=f"{factor:.0f} x real time")

        yield show
