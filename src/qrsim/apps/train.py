"""``qrsim train``."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from qrsim.apps import Repeated, progress_bar
from qrsim.errors import UsageError, did_you_mean
from qrsim.extras import require

if TYPE_CHECKING:
    from qrsim.studies.learn.board import Board
    from qrsim.studies.learn.training import Plan, Training, Tried

NOTHING = "nothing"
STARTS = ("baseline", NOTHING)
MOST_ENVS, MOST_STEPS = 65_536, 10**12


@dataclass(frozen=True)
class Train:
    """Train a policy for a task by proximal policy optimisation.

    Many episodes are flown side by side, all agents with the same policy. Training has cycles of the length of an
    episode. After each cycle the policy flies 64 episodes that it does not learn from, or 200 with --start.
    In a long pursuit it flies 64, and the first 200 s of 1000 others. The mean return and the part flown to the end
    are printed. The best policy is kept in DIR/policy.npz, for 'qrsim score', 'qrsim run' and 'qrsim check'.
    DIR/curve.csv has a row for each cycle. Ctrl-C ends a training, and --resume continues it from its last cycle.

    Example:
      qrsim train keep_spot --steps 1000000
      qrsim train goto_waypoint --minutes 5 --out runs/goto
      qrsim score goto_waypoint --policy runs/goto/policy.npz
    """

    task: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="TASK")]
    """Name of a scenario with a task, or a YAML file."""
    seed: int = 0
    """Seed of all randomness. Equal seeds give equal policies, bit for bit, on equally many cores of one machine."""
    steps: Annotated[
        int | None,
        tyro.conf.arg(help_behavior_hint="(default: 3000000; pursuits 2400000; rates and motors 3500000)"),
    ] = None
    """Decisions of all agents, after which the training ends."""
    minutes: Annotated[float | None, tyro.conf.arg(help_behavior_hint="(default: no limit)")] = None
    """Wall time, after which the training ends earlier."""
    start: Annotated[
        str | None,
        tyro.conf.arg(metavar="START", help_behavior_hint="(default: nothing; pursuits, rates and motors: baseline)"),
    ] = None
    """First policy: 'baseline' imitates the task's baseline, a policy file goes on from it, 'nothing' is random."""
    fleet: Annotated[str | None, tyro.conf.arg(help_behavior_hint="(default: the only one)")] = None
    """Fleet of agents that learns, in a task with agents of several; the task's baseline flies the others."""
    others: Annotated[str | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Policy file that flies another fleet of agents, in place of the baseline."""
    envs: Annotated[int | None, tyro.conf.arg(help_behavior_hint="(default: as suits the task, 64 to 512)")] = None
    """Number of episodes side by side, 1 to 65536."""
    set: Annotated[Repeated, tyro.conf.arg(metavar="PATH=VALUE", help_behavior_hint="(default: none)")] = field(
        default_factory=list
    )
    """Change one value of the scenario; can be given several times."""
    integral: bool = False
    """Add the integral of the offset to the goal to the inputs, which makes up for a steady wind."""
    out: Annotated[
        Path | None,
        tyro.conf.arg(aliases=["-o"], metavar="DIR", help_behavior_hint="(default: runs/TASK-policy-seedSEED)"),
    ] = None
    """Folder to write; must be empty or not exist without --resume."""
    resume: bool = False
    """Continue the training in --out, from its last checkpoint."""
    tensorboard: bool = False
    """Write the curve for TensorBoard too: event files in the folder."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> None:
        """Run ``qrsim train``: check the options, train a policy for a task, and print the result."""
        self._check()
        require("learn", "qrsim train")
        if self.tensorboard:
            require("tensorboard", "--tensorboard")
        from qrsim.studies.learn.folder import make_folder, restore, save, save_policy
        from qrsim.studies.learn.suited import plan_of
        from qrsim.studies.learn.training import Training

        seconds = None if self.minutes is None else 60.0 * self.minutes
        given: dict[str, Any] = {} if self.start is None else {"start": None if self.start == NOTHING else self.start}
        if self.steps is not None:
            given["steps"] = self.steps
        plan = plan_of(
            self.task,
            tuple(self.set),
            self.envs,
            seed=self.seed,
            seconds=seconds,
            integral=self.integral,
            fleet=self.fleet,
            others=self.others,
            **given,
        )
        folder = self.out or Path("runs") / f"{_name_of(plan)}-policy-seed{self.seed}"
        if folder.exists() and not self.resume and not (folder.is_dir() and not any(folder.iterdir())):
            raise UsageError(f"{folder} exists and is never overwritten; choose another --out, or add --resume")
        training = Training(plan, begins=not self.resume)
        if not self.resume:
            make_folder(folder)
        elif warning := restore(training, folder):
            print(f"warning: {warning}", file=sys.stderr)
        board = self._board(folder, training.steps)
        try:
            with progress_bar("training", plan.steps, "{task.fields[best]}", best="") as update:
                for row in training.cycles(lambda steps: update(completed=steps)):
                    save(training, folder)
                    if board is not None:
                        board.add(row)
                    update(best=f"best: {_shown(training.best)}")
                    self._tell_row(row)
        except KeyboardInterrupt:
            if training.keep_untried():
                save_policy(training, folder)
            if training.best is not None:
                print(f"the best policy so far is in {folder / 'policy.npz'}", file=sys.stderr)
            raise
        finally:
            if board is not None:
                board.close()
        self._tell(training, folder)

    def _board(self, folder: Path, steps: int) -> Board | None:
        """Return the writer of TensorBoard event files with --tensorboard, None without it."""
        from qrsim.studies.learn.board import Board

        return Board(folder, steps) if self.tensorboard else None

    def _check(self) -> None:
        """Raise UsageError for options out of range.

        Raises:
            UsageError: one is.
        """
        if not 0 <= self.seed < 2**32:
            raise UsageError(f"--seed {self.seed}: expected 0 to 2**32 - 1")
        if self.steps is not None and not 1 <= self.steps <= MOST_STEPS:
            raise UsageError(f"--steps {self.steps}: expected 1 to {MOST_STEPS}")
        if self.minutes is not None and not (math.isfinite(self.minutes) and self.minutes > 0.0):
            raise UsageError(f"--minutes {self.minutes:g}: expected a positive number")
        if self.start not in (None, *STARTS) and not self.start.endswith(".npz"):
            hint = did_you_mean(self.start, STARTS)
            raise UsageError(f"--start {self.start}: expected {', '.join(STARTS)} or a policy file (.npz){hint}")
        if self.envs is not None and not 1 <= self.envs <= MOST_ENVS:
            raise UsageError(f"--envs {self.envs}: expected 1 to {MOST_ENVS}")

    def _tell_row(self, row: Tried) -> None:
        """Print a row of the training's progress: one cycle and its scores."""
        if self.json:
            return
        text = f"cycle {row.cycle}, {row.steps} steps, {row.seconds:.0f} s: mean return {row.mean_return:.4g}, "
        print(f"{text}flown to the end {row.flown_to_the_end:.3g}", flush=True)

    def _tell(self, training: Training, folder: Path) -> None:
        """Print the result of the training, as text or JSON."""
        policy = folder / "policy.npz"
        if self.json:
            best = None if training.best is None else asdict(training.best[1])
            found = {
                "task": training.view.task,
                "seed": self.seed,
                "steps": training.steps,
                "best": best,
            }
            found |= {"curve": [asdict(row) for row in training.curve], "policy": str(policy)}
            print(json.dumps(found, indent=2, allow_nan=False))
            return
        print(f"best: {_shown(training.best)}")
        print(f"policy: {policy}; compare it by 'qrsim score {self.task} --policy {policy}'")


def _name_of(plan: Plan) -> str:
    """Return the task's name for a folder; raises UsageError for a task that cannot be learned."""
    from qrsim.envs.functional import Functional

    return Functional.of(plan.task, plan.overrides).name.replace("/", "_")


def _shown(best: tuple[object, Tried] | None) -> str:
    """Return the best policy's scores as text."""
    if best is None:
        return "none yet"
    row = best[1]
    return f"mean return {row.mean_return:.4g}, flown to the end {row.flown_to_the_end:.3g} (cycle {row.cycle})"
