"""``qrsim sweep``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from qrsim.apps import Repeated, progress_bar
from qrsim.errors import UsageError

if TYPE_CHECKING:
    from qrsim.core.arrays import NumpyArray
    from qrsim.studies.sweep.plan import Batch, Plan
    from qrsim.studies.sweep.study import Study


@dataclass(frozen=True)
class Sweep:
    """Fly a study: a scenario under many conditions, with many seeds each, on all cores or on a cluster.

    A study lists the parameters that vary, the seeds for each condition, and the metrics; docs/howto/own_study.md
    explains it.

    Results go to a store, an xarray Dataset in Zarr, as they come in, and can be read from there at once. To continue
    an interrupted or killed sweep, run the same command again.

    Studies that come with qrsim: station_keeping, station_keeping_plain, gnss_errors, swarm_collisions,
    formation_gusts, search_in_wind, team_errors.

    Example:
      qrsim sweep station_keeping --seeds 4 --values 5
      qrsim sweep my_study.yaml --workers 8 --out sweeps/first.zarr
      qrsim sweep my_study.yaml --scheduler tcp://192.168.0.1:8786
      qrsim sweep-report sweeps/station_keeping.zarr
    """

    study: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="STUDY")]
    """Name of a study that comes with qrsim, or a YAML file."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: one for each core)")] = None
    """Processes to fly with."""
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: none)")] = None
    """Fly on the workers of this Dask scheduler instead."""
    tls_ca: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """CA certificate for a scheduler at tls://; with --tls-cert and --tls-key."""
    tls_cert: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Certificate to show to that scheduler."""
    tls_key: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Private key of that certificate."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="STORE", help_behavior_hint="(default: sweeps/NAME.zarr)")] = None
    """Store to write, or to continue."""
    seeds: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the study's)")] = None
    """Episodes at each point."""
    points: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the study's)")] = None
    """Points of the sample."""
    values: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: all)")] = None
    """Largest number of values for each parameter with values, evenly selected."""
    set: Annotated[Repeated, tyro.conf.arg(metavar="PATH=VALUE")] = field(default_factory=list)
    """Change one value of the scenario at all points; can be given several times."""
    plan: bool = False
    """Check the study and print the planned flights."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> None:
        """Run ``qrsim sweep``: check the study, fly the batches that are missing, and print the store's path."""
        study = self._study()
        from qrsim.extras import require

        require("sweep", "qrsim sweep")
        from qrsim.studies.sweep.prepare import plan_of

        plan = plan_of(study)
        out = self.out or Path("sweeps") / f"{study.spec.name}.zarr"
        if self.plan:
            self._tell(_planned(plan), f"{_sentence(plan)}\nstore: {out}")
            return
        self._fly(plan, out)

    def _study(self) -> Study:
        """Load the study, changed by options; raises UsageError for options out of range."""
        from qrsim.studies.sweep.study import load_study

        for name in ("workers", "seeds", "points", "values"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise UsageError(f"--{name} {value}: expected a positive number")
        if self.workers is not None and self.scheduler is not None:
            raise UsageError("--workers: not with --scheduler, which has its own")
        files = {"--tls-ca": self.tls_ca, "--tls-cert": self.tls_cert, "--tls-key": self.tls_key}
        missing = [name for name, file in files.items() if file is None]
        if 0 < len(missing) < len(files):
            raise UsageError(f"{missing[0]}: missing; TLS needs {', '.join(files)}")
        if not missing and self.scheduler is None:
            raise UsageError("--tls-ca: without --scheduler; workers of this machine use their own keys")
        changes = {name: value for name in ("seeds", "points") if (value := getattr(self, name)) is not None}
        return load_study(self.study, changes, self.set, self.values or 0)

    def _fly(self, plan: Plan, out: Path) -> None:
        """Fly the batches that are missing in the store ``out``, and print the result."""
        from qrsim.engine.settings import available_cores
        from qrsim.studies.sweep.cluster import Tls, workers_of
        from qrsim.studies.sweep.store import Store
        from qrsim.studies.sweep.sweeping import sweep

        begun = time.perf_counter()
        store = Store(out, plan)
        before = _episodes(plan, store.done)
        flying = 0.0
        try:
            if not store.done.all():
                tls = None
                if self.tls_ca is not None and self.tls_cert is not None and self.tls_key is not None:
                    tls = Tls(self.tls_ca, self.tls_cert, self.tls_key)
                with workers_of(self.scheduler, self.workers or available_cores(), tls) as client:
                    flying = time.perf_counter()
                    with _progress(plan, before) as progress:
                        sweep(plan, store, client, progress)
                    flying = time.perf_counter() - flying
        finally:
            store.close()
        flown = plan.episodes - before
        simulated = _simulated(plan) * flown / max(1, plan.episodes)
        result = {
            **_planned(plan),
            "store": str(out),
            "flown": flown,
            "simulated_s": simulated,
            "wall_s": round(time.perf_counter() - begun, 3),
            "flying_s": round(flying, 3),
            "bytes_per_episode": round(store.bytes_per_episode(), 1),
        }
        was = f", {before} of them before" if before else ""
        fast = f" in {flying:.1f} s ({simulated / flying:.0f} times real time)" if flown else ""
        self._tell(
            result,
            f"{_sentence(plan)}{was}: {flown} flown{fast}\nstore: {out}\nto see the results: qrsim sweep-report {out}",
        )

    def _tell(self, result: Mapping[str, object], text: str) -> None:
        """Print a result as JSON with --json, else its text."""
        if self.json:
            import json

            print(json.dumps(result, indent=2))
        else:
            print(text)


def _planned(plan: Plan) -> dict[str, object]:
    """Return a plan's name, dimensions and numbers of points, episodes and batches as a dict for JSON."""
    return {
        "study": plan.study.spec.name,
        "digest": plan.study.digest,
        "dimensions": dict(zip(plan.dims, plan.shape, strict=True)),
        "points": plan.points,
        "episodes": plan.episodes,
        "batches": plan.batches,
        "programs": len(plan.groups),
    }


def _sentence(plan: Plan) -> str:
    """Return a sentence on a plan's number of episodes and batches."""
    sizes = " x ".join(f"{size} {name}" for name, size in zip(plan.dims, plan.shape, strict=True))
    return f"{plan.study.spec.name}: {plan.episodes} episodes ({sizes}) in {plan.batches} batches"


def _episodes(plan: Plan, done: NumpyArray) -> int:
    """Return the number of episodes in the batches that are done (bool array)."""
    import math

    import numpy as np

    regions = (plan.region(int(index)) for index in np.flatnonzero(done))
    return sum(math.prod(part.stop - part.start for part in region) for region in regions)


def _simulated(plan: Plan) -> float:
    """Return the simulated time [s] of all episodes of a plan together."""
    durations = [group.ticks * group.time_step for group in plan.groups.values()]
    return plan.episodes * sum(durations) / len(durations)


@contextmanager
def _progress(plan: Plan, before: int) -> Iterator[Callable[[Batch], None]]:
    """Show a bar of episodes and real-time factor in the context, on a terminal only; yield a function that adds a
    batch. ``before``: episodes done earlier."""
    begun, simulated = time.perf_counter(), 0.0
    texts = "{task.completed:.0f} of {task.total:.0f} episodes", "{task.fields[factor]}"
    with progress_bar(plan.study.spec.name, plan.episodes, *texts, completed=before, factor="starting") as update:

        def show(batch: Batch) -> None:
            """Add a batch to the progress bar and update the real-time factor."""
            nonlocal simulated
            group = plan.groups[batch.group]
            simulated += batch.episodes * group.ticks * group.time_step
            factor = simulated / max(time.perf_counter() - begun, 1e-9)
            update(advance=batch.episodes, factor=f"{factor:.0f} x real time")

        yield show
