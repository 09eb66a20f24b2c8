"""What ``qrsim train`` learns with its defaults: several seeds of each task, tried in the same new episodes.

Each policy then flies 200 episodes that nothing was learned from and that no policy was chosen by; so do hovering and
the baseline. A vehicle within ``NEAR`` of the waypoint at the end has reached it, on the pad it must stand too, and a
cat must be as near to where it catches the mouse. Cats learn in short episodes and are tried in whole ones. Mice learn
against the baseline's cats, and their return is compared with that of mice that flee by the script. Times are of one
process with one thread, programs loaded; the processor's time does not depend on what else the machine does. The part
``loop`` has what benchmarks/training.py prints: decisions per second of a training and of the bare environments.
"""

from __future__ import annotations

import json
import time
from typing import Any

import numpy as np

from evidence import IMAGES, ROOT
from evidence._processes import printed
from evidence.returns import fly
from evidence.tasks import summary
from qrsim.envs.batch import Batch
from qrsim.envs.functional import Functional
from qrsim.envs.objective import objective_of
from qrsim.envs.one_side import OneSide
from qrsim.envs.scoring import HOVER, maker
from qrsim.envs.viewing import batch_of, view_of
from qrsim.runs.picture import new_figure, save_picture
from qrsim.studies.learn.suited import plan_of
from qrsim.studies.learn.training import Plan, Training
from qrsim.tasks.baselines.many import Many
from qrsim.tasks.direct import DIRECT
from qrsim.tasks.learned import forward

DOC = "policies of qrsim train on the simple tasks and in a pursuit, several seeds each, against the baseline"
TRIALS, SMALL_TRIALS = 200, 8
PURSUIT, SEARCH = "cats_and_mouse/1A", "search_small"
# The baseline of the published searches flies this one too, by whole pictures.
PICTURES = ["task.observes=picture"]
# Decisions that each seed learns from, and how many seeds.
STEPS = {
    "keep_spot": 600_000,
    "goto_waypoint": 3_000_000,
    "keep_velocity": 1_200_000,
    "land_on_pad": 2_000_000,
    PURSUIT: 2_400_000,
    "keep_formation": 3_000_000,
    SEARCH: 1_000_000,
}
SEEDS = 10
# A mouse that is an agent: decisions, and seeds.
BOTH, MOUSE_STEPS, MOUSE_SEEDS = "task.mouse=agent", 320_000, 10
NEAR = 3.0
# An X500 that keeps its spot by body rates and by rotor speeds, and seeds of each.
X500 = (
    "fleets.pelicans.vehicle={type: multirotor, model: x500}",
    "fleets.pelicans.controller.type=cascade",
    "task.effort.hover_throttle=0.77",
)
DIRECT_SEEDS = 3
# Those whose curves are drawn.
DRAWN = ("keep_velocity", "land_on_pad", PURSUIT)
IMAGE = IMAGES / "learning_curves.png"
REPORT = ROOT / "docs" / "evidence" / "learn.json"


def key(task: str) -> str:
    """Return the name of a task in the results."""
    return task.replace("/", "_")


# The comparison with what ships, for each task, and each seed of each task: every part takes a minute or two.
EACH = tuple(f"{key(task)}_{part}" for task in STEPS for part in ("compared", *range(SEEDS)))
# The figure, of what the other parts have found.
CURVES = "curves"
MICE = ("mouse_compared", *(f"mouse_{seed}" for seed in range(MOUSE_SEEDS)))
BY_ACTIONS = tuple(f"{actions}_{part}" for actions in DIRECT for part in ("compared", *range(DIRECT_SEEDS)))
# Decisions per second of a training, and of the bare environments: rows of the benchmark.
LOOP = ("hover", "random", "training")
PARTS = (*EACH, *MICE, *BY_ACTIONS, "loop", CURVES)

Values = np.ndarray[Any, Any]


def run(full: bool, parts: tuple[str, ...] = PARTS) -> dict[str, Any]:
    """Return the results of each part; the small form trains briefly in short episodes."""
    if not full:
        plan = Plan("keep_spot", ("duration=2",), envs=64, steps=4096, tries=SMALL_TRIALS)
        return {"keep_spot_seed_0": trained(plan, SMALL_TRIALS)}
    found: dict[str, Any] = {"seeds": SEEDS, "trials": TRIALS, "near_m": NEAR}
    for task, steps in STEPS.items():
        if f"{key(task)}_compared" in parts:
            found[key(task)] = {"steps": steps, **compared(task)}
        for seed in range(SEEDS):
            if f"{key(task)}_{seed}" in parts:
                plan = plan_of(task, seed=seed, steps=steps)
                found[f"{key(task)}_seed_{seed}"] = trained(plan, TRIALS)
    if MICE[0] in parts:
        found["mouse"] = {"steps": MOUSE_STEPS, "baseline": fleeing()}
    for seed in range(MOUSE_SEEDS):
        if MICE[1 + seed] in parts:
            plan = plan_of(PURSUIT, (BOTH,), seed=seed, steps=MOUSE_STEPS, fleet="mice")
            found[f"mouse_seed_{seed}"] = trained(plan, TRIALS)
    for actions in DIRECT:
        changes = (*X500, f"task.actions={actions}")
        if f"{actions}_compared" in parts:
            found[actions] = compared("keep_spot", changes)
        for seed in range(DIRECT_SEEDS):
            if f"{actions}_{seed}" in parts:
                found[f"{actions}_seed_{seed}"] = trained(plan_of("keep_spot", changes, seed=seed), TRIALS)
    if "loop" in parts:
        rows = [{key: row[key] for key in row if key != "what"} for row in printed("training")]
        found["loop"] = dict(zip(LOOP, rows, strict=True))
    if CURVES in parts:
        known = found if len(parts) > 1 else json.loads(REPORT.read_text("utf-8"))["results"]
        save_picture(lambda: draw(known), IMAGE)
    return found


def trained(plan: Plan, trials: int) -> dict[str, Any]:
    """Return how the best policy of a training does in new episodes of the whole task, and what the training took."""
    training = Training(plan)
    wall, processor = time.perf_counter(), time.process_time()
    cycles = list(training.cycles())
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    assert training.best is not None
    policy, _ = training.best
    flights = training.flights_of(trials)
    total, alive = flights.fly(lambda seen: forward(policy.layers, policy.scaling.scaled(seen)), np.arange(trials))
    return {
        "decisions": cycles[-1].steps,
        "wall_s": round(wall, 1),
        "processor_s": round(processor, 1),
        "near": float(np.mean(alive & near(flights.batch))),
        **summary(total, alive),
        "curve": {f"steps_{row.steps}": round(row.mean_return, 4) for row in cycles},
    }


def compared(task: str, overrides: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return how hovering and the baseline do in the same episodes, and the part that ends near the goal."""
    found, view = {}, view_of(Functional.of(task, overrides))
    for name, changes in ((HOVER, []), ("baseline", []), *((("pictures", PICTURES),) if task == SEARCH else ())):
        batch = batch_of(task, TRIALS, [*overrides, *changes], view)
        play = batch.functional.play
        total, alive = fly(batch, flown_by("baseline" if changes else name, play))
        found[name] = summary(total, alive)
        if not changes:
            found[name]["near"] = float(np.mean(alive & near(batch)))
    return found


def flown_by(name: str, play: Any) -> Any:
    """Return a function of a step and the observations of all episodes that returns a built-in policy's actions."""
    if name == HOVER:
        still = maker(HOVER, play)(play, 0).act(None)
        return lambda _, seen: still
    many = Many(play, TRIALS)
    many.begin()
    return lambda _, seen: many.act(seen)


def fleeing() -> dict[str, Any]:
    """Return how mice that flee as the script does, once a second, do against the baseline's cats."""
    batch = Batch(PURSUIT, TRIALS, [BOTH])
    mice = OneSide(batch, "mice")
    mice.reset(np.arange(TRIALS))
    total, alive = np.zeros(TRIALS), np.ones(TRIALS, bool)
    for _ in range(batch.functional.play.steps):
        reward, terminated, _ = mice.step(mice.baseline())
        total += np.where(alive, reward[:, 0].astype(np.float64), 0.0)
        alive &= ~terminated
    return summary(total, alive)


def near(batch: Any) -> Values:
    """Return for each episode (B,) whether all agents are near their goals now, or have the wanted velocity."""
    errors = objective_of(batch, 0.98)
    errors.begin(batch)
    found: Values = errors.errors(batch).reshape(batch.size, -1).max(axis=1) <= NEAR  # type: ignore[attr-defined]
    return found


def draw(found: dict[str, Any]) -> Any:
    """Draw the mean return of each seed against its decisions, their median, and what the baseline returns."""
    figure = new_figure(9.5, 3.4)
    for axes, task in zip(figure.subplots(1, len(DRAWN)), DRAWN, strict=True):
        trainings = [found.get(f"{key(task)}_seed_{seed}", {}) for seed in range(SEEDS)]
        curves = [each["curve"] for each in trainings if "curve" in each]
        rows = [[int(name.removeprefix("steps_")) / 1e6 for name in curve] for curve in curves]
        # Crashes in an imitation leave fewer decisions, so that seeds of a pursuit have other rows.
        steps = np.array(rows[0])
        values = np.array(
            [np.interp(steps, row, list(curve.values())) for row, curve in zip(rows, curves, strict=True)]
        )
        axes.fill_between(steps, values.min(axis=0), values.max(axis=0), alpha=0.25, lw=0.0, label="all seeds")
        axes.plot(steps, np.median(values, axis=0), lw=1.6, label="median")
        if key(task) in found:
            axes.axhline(found[key(task)]["baseline"]["mean"], color="black", ls="--", lw=1.0, label="baseline")
        axes.set_yscale("symlog", linthresh=1.0)
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_ylim(top=-1.0)
        axes.set_title(task, fontsize=10)
        axes.set_xlabel("decisions [million]")
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("mean return of an episode")
    figure.axes[0].legend(fontsize=8, loc="lower right")
    return figure
