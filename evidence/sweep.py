"""Sweeps: how fast beside the raw core, and whether what comes out is the same whatever happens on the way.

Every program runs in processes of its own. The raw core is ``qrsim.rollout`` of as many worlds of the same structure
for as many ticks, in turns with the sweep, both compiled before; medians of the rounds are compared. Datasets are the
same where every coordinate, metric and attribute is, to the bit.
"""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from tests.studies.sweep.killing import SMALL, dask, finish, kill_process, kill_worker, opened, same, scheduler, sweep

from evidence._processes import program
from qrsim.scenarios.reading import dump_yaml

DOC = "time of 10 000 episodes beside the raw core, kills, workers and clusters, memory of a study of a million points"
SEED = 0
STUDY = "station_keeping_plain"
# Words for ``qrsim sweep``: a part of the study, for what is flown many times.
PART = [STUDY, "--seeds", "12", "--values", "8"]
ROUNDS, WORKERS, MILLION = 3, 2, 2**20

THROUGHPUT = """
import json, sys, tempfile, time
from pathlib import Path

import qrsim
from qrsim.studies.sweep.cluster import workers_of
from qrsim.studies.sweep.flying import fly
from qrsim.studies.sweep.prepare import plan_of
from qrsim.studies.sweep.store import Store
from qrsim.studies.sweep.study import load_study
from qrsim.studies.sweep.sweeping import Jobs, sweep

if __name__ == "__main__":
    study, rounds, workers = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    qrsim.configure(cpu_devices=workers)
    plan = plan_of(load_study(study))
    (group,) = plan.groups.values()
    steps = plan.episodes * group.ticks * group.vehicles

    def raw():
        begun = time.perf_counter()
        qrsim.rollout(group.world, ticks=group.ticks, worlds=plan.episodes)
        return time.perf_counter() - begun

    with tempfile.TemporaryDirectory() as folder, workers_of(None, workers) as client:
        first = Store(Path(folder) / "first.zarr", plan)
        job = Jobs(plan, first.metrics).job(plan.batch(0))
        first.close()
        client.gather([client.submit(fly, job, workers=[name], pure=False) for name in client.nthreads()])
        raw()
        times = {"sweep": [], "raw": []}
        for number in range(rounds):
            times["raw"].append(raw())
            store = Store(Path(folder) / f"{number}.zarr", plan)
            begun = time.perf_counter()
            sweep(plan, store, client)
            times["sweep"].append(time.perf_counter() - begun)
            size = store.bytes_per_episode()
            store.close()
    print(json.dumps({"episodes": plan.episodes, "episode_s": group.ticks * group.time_step, "batches": plan.batches,
                      "vehicle_steps": steps, "bytes_per_episode": size, **times}))
"""

MEMORY = """
import json, sys, tempfile
from pathlib import Path

from evidence._processes import peak_bytes
from qrsim.studies.sweep.prepare import plan_of
from qrsim.studies.sweep.store import Store
from qrsim.studies.sweep.study import load_study

with tempfile.TemporaryDirectory() as folder:
    study = Path(folder) / "million.yaml"
    study.write_text(f'''
name: million
scenario: keep_spot
set: {{world.wind: {{type: log_shear, speed_20ft: 0.0, wind_from_deg: 225.0}}}}
vary:
  world.wind.speed_20ft: {{low: 0.0, high: 8.0}}
  world.turbulence.speed_20ft: {{low: 0.5, high: 10.0}}
  fleets.pelicans.vehicle.mass: {{low: 1.5, high: 2.0}}
sampling: {{type: sobol, points: {sys.argv[1]}}}
seeds: 1
metrics: [tracking_error_rms_m]
''')
    few = plan_of(load_study(str(study), {"points": 1024}))
    Store(Path(folder) / "few.zarr", few).close()
    before = peak_bytes()
    plan = plan_of(load_study(str(study)))
    store = Store(Path(folder) / "million.zarr", plan)
    total = sum(plan.batch(index).episodes for index in range(plan.batches))
    store.close()
    print(json.dumps({"points": plan.points, "planned": total, "batches": plan.batches, "before_bytes": before,
                      "more_bytes": peak_bytes() - before}))
"""


def throughput(study: str, rounds: int) -> dict[str, Any]:
    """Return times of a study of one program on two cores, and the ratio to the raw core."""
    found = program(THROUGHPUT, study, str(rounds), str(WORKERS))
    seconds = {name: statistics.median(found.pop(name)) for name in ("sweep", "raw")}
    return {
        **found,
        "workers": WORKERS,
        "rounds": rounds,
        "sweep_s": seconds["sweep"],
        "ratio": seconds["raw"] / seconds["sweep"],
    }


def million(points: int) -> dict[str, Any]:
    """Return how much more memory it takes to plan so many points than to plan 1024."""
    return program(MEMORY, str(points))


def sameness(words: list[str], after: int) -> dict[str, Any]:
    """Return whether a study is the same on 1 worker, on 2, on separate processes, and after kills; 1 for yes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        stores = {what: folder / f"{what}.zarr" for what in ("one", "two", "cluster", "process", "worker")}
        finish(sweep(stores["one"], words, "--workers", "1"))
        finish(sweep(stores["two"], words, "--workers", "2"))
        with (
            scheduler(folder) as address,
            dask("worker", address, "--nthreads", "1", "--local-directory", name),
            dask("worker", address, "--nthreads", "1", "--local-directory", name),
        ):
            finish(sweep(stores["cluster"], words, "--scheduler", address))
        kill_process(stores["process"], words, after)
        kill_worker(stores["worker"], words, after)
        first = opened(stores["one"])
        found: dict[str, Any] = {what: int(same(first, opened(store))) for what, store in stores.items()}
    return {
        "episodes": int(first["flown"].size),
        "batches": written_batches(first),
        "same": {what: found[what] for what in ("two", "cluster", "process", "worker")},
    }


def written_batches(dataset: Any) -> int:
    """Return how many batches a complete Dataset has."""
    chunks = dataset["flown"].encoding["chunks"]
    return int(np.prod([-(-size // step) for size, step in zip(dataset["flown"].shape, chunks, strict=True)]))


def run(full: bool) -> dict[str, Any]:
    """Return time, sameness and memory."""
    if not full:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "small.yaml"
            path.write_text(dump_yaml(SMALL), encoding="utf-8")
            return {"throughput": throughput(str(path), 1), "million": million(2**18)}
    return {"throughput": throughput(STUDY, ROUNDS), "sameness": sameness(PART, 6), "million": million(MILLION)}
