"""``qrsim score``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from qrsim.apps import Repeated, progress_bar
from qrsim.errors import UsageError
from qrsim.files import Content

if TYPE_CHECKING:
    from qrsim.envs.functional import Functional
    from qrsim.envs.scoring import Interval, Scored
    from qrsim.tasks.play import Play

MOST_SEEDS = 10_000


@dataclass(frozen=True)
class Score:
    """Fly policies in the same episodes of a task, and compare their returns.

    Prints for every policy the mean return of an agent with a 95 % bootstrap interval over the episodes, and the paired
    difference to the first policy. It also prints the number of episodes flown to the end and, in a search, the persons
    found. The task's baseline, if it has one, and hovering are always included.

    POLICY is 'baseline', 'hover', 'random', 'oracle' (in a search; it knows the persons' positions), the policy.npz of
    'qrsim train', or MODULE:NAME, where MODULE may be a .py file. MODULE:NAME is a function from the observations of
    all agents to their actions (n, A) in [-1, 1], or a class that is made for each episode with (play, seed). The class
    has act(seen), answer() in tasks that ask for an answer, and optionally know(state), which gets the true state
    before every act.

    Example:
      qrsim score search_and_rescue/2A
      qrsim score keep_spot --policy my_policy.py:fly --seeds 100 --out scores.png
      qrsim score cats_and_mouse/1C --set world.wind.speed_20ft=5 --json
      qrsim score keep_spot --seeds 100 --dataset keep_spot/baseline-v0
    """

    task: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="TASK")]
    """Name of a scenario with a task, or a YAML file."""
    policy: Annotated[Repeated, tyro.conf.arg(metavar="POLICY", help_behavior_hint="(default: none)")] = field(
        default_factory=list
    )
    """Policy to fly; can be given several times. The others are compared with the first."""
    seeds: int = 20
    """Number of episodes."""
    first_seed: int = 0
    """Seed of the first episode; the others follow."""
    set: Annotated[Repeated, tyro.conf.arg(metavar="PATH=VALUE", help_behavior_hint="(default: none)")] = field(
        default_factory=list
    )
    """Change one value of the scenario; can be given several times."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE")] = None
    """Picture to write, .png, .pdf or .svg: all returns, and an episode of the first policy."""
    dataset: Annotated[str | None, tyro.conf.arg(metavar="ID")] = None
    """Also keep all episodes of the first policy as a new dataset of Minari, such as keep_spot/baseline-v0, in
    MINARI_DATASETS_PATH, or ~/.minari/datasets. Only for tasks with one agent and no radio."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> None:
        """Run ``qrsim score``: fly episodes of a task by each policy, then print and draw the scores."""
        if not 1 <= self.seeds <= MOST_SEEDS:
            raise UsageError(f"--seeds {self.seeds}: expected 1 to {MOST_SEEDS}")
        if not 0 <= self.first_seed < 2**62:
            raise UsageError(f"--first-seed {self.first_seed}: expected 0 to 2**62 - 1")
        from qrsim.envs.batch import Batch
        from qrsim.envs.dataset import Recording, free_place, write
        from qrsim.envs.scoring import score_task

        if self.dataset is not None:
            free_place(self.dataset)
        makers = self._makers(Batch(self.task, 1, self.set).functional)
        batch = Batch(self.task, self.seeds, self.set)
        recording = None if self.dataset is None else Recording(batch)
        with _progress(len(makers), batch.functional.play.steps) as told:
            found = score_task(batch, makers, self.first_seed, self.out is not None, told, recording)
        kept = None
        if self.dataset is not None and recording is not None:
            kept = write(self.dataset, recording, found[0].name, self.task, self.set)
        if self.out is not None:
            from qrsim.envs.score_figure import draw_scores
            from qrsim.runs.picture import save_picture

            save_picture(lambda: draw_scores(batch.functional.name, found), self.out)
        self._tell(batch.functional.name, found, kept)

    def _makers(self, functional: Functional) -> Content:
        """Return policy name -> function that builds the policy, for the task's functions."""
        from qrsim.envs import VERSION
        from qrsim.envs.scoring import BASELINE, BUILT_IN, HOVER, maker
        from qrsim.interface.policies import load_function
        from qrsim.tasks.learned import is_policy_file, read_policy

        play = functional.play
        makers: dict[str, object] = {}
        for name in self.policy:
            if name in makers:
                raise UsageError(f"--policy {name}: given twice")
            if is_policy_file(name):
                makers[name] = read_policy(name).maker(play, functional.name, VERSION)
                continue
            makers[name] = maker(name if name in BUILT_IN else load_function("policy", name, BUILT_IN), play)
        if BASELINE not in makers and not self.policy_missing(play):
            makers[BASELINE] = maker(BASELINE, play)
        return makers if HOVER in makers else {**makers, HOVER: maker(HOVER, play)}

    def policy_missing(self, play: Play) -> bool:
        """Return whether the task of a ``Play`` lacks a baseline policy."""
        from qrsim.tasks.baselines import baseline

        try:
            baseline(play)
        except UsageError:
            return True
        return False

    def _tell(self, task: str, found: list[Scored], kept: Path | None) -> None:
        """Print the policies' scores as a table or JSON; ``kept``: folder of the dataset, if one was written."""
        rows = [_row(each, found[0]) for each in found]
        if self.json:
            import json

            whole = {"task": task, "seeds": self.seeds, "first_seed": self.first_seed, "policies": rows}
            written = {"figure": str(self.out) if self.out else None, "dataset": str(kept) if kept else None}
            print(json.dumps({**whole, **written}, indent=2, allow_nan=False))
            return
        from rich.console import Console
        from rich.table import Table

        table = Table(title=f"{task}: {self.seeds} episodes from seed {self.first_seed}", title_justify="left")
        search = found[0].persons_found is not None
        persons = ("persons found",) if search else ()
        others = [f"return of {fleet}" for fleet in found[0].others]
        for column in (
            "policy",
            "mean return",
            "95 % interval",
            "flown to the end",
            *others,
            *persons,
            f"less {found[0].name}",
        ):
            table.add_column(column, justify="left" if column == "policy" else "right")
        for row in rows:
            less, finds = row["difference"], row.get("persons_found")
            table.add_row(
                row["policy"],
                f"{row['mean']:.4g}",
                _span(row),
                f"{row['flown_to_the_end']:.3g}",
                *(f"{told['mean']:.4g} {_span(told)}" for told in row.get("others", {}).values()),
                *([f"{finds['mean']:.3g} {_span(finds)}"] if finds else []),
                "-" if less is None else f"{less['mean']:.3g} {_span(less)}",
            )
        Console(width=None if sys.stdout.isatty() else 130 if search or others else 110).print(table)
        if self.out is not None:
            print(f"figure: {self.out}")
        if kept is not None:
            print(f"dataset: {kept}, minari.load_dataset('{self.dataset}')")


def _row(each: Scored, first: Scored) -> Content:
    """Return a policy's scores as a dict for JSON, with the difference from the ``first`` policy."""
    from qrsim.envs.scoring import Interval

    less = None if each is first else _told(each.less(first))
    returns = [float(value) for value in each.returns]
    flown = float(each.alive.mean())
    row: Content = {
        "policy": each.name,
        **_told(each.interval),
        "flown_to_the_end": flown,
        "difference": less,
        "returns": returns,
    }
    if each.others:
        row["others"] = {fleet: _told(Interval.of(returns)) for fleet, returns in each.others.items()}
    interval = each.persons_found_interval
    if each.persons_found is not None and interval is not None:
        row["persons_found"] = {
            **_told(interval),
            "episodes": each.persons_found.astype(int).tolist(),
        }
    return row


def _told(interval: Interval) -> dict[str, float | None]:
    """Return a confidence interval as a dict for JSON, with None in place of NaN."""
    numbers = {"mean": interval.mean, "low": interval.low, "high": interval.high}
    return {name: value if value == value else None for name, value in numbers.items()}


def _span(row: Mapping[str, object]) -> str:
    """Return a score's confidence interval in brackets as text; "" without one."""
    return "" if row["low"] is None else f"({row['low']:.4g} to {row['high']:.4g})"


@contextmanager
def _progress(policies: int, steps: int) -> Iterator[Callable[[str, int], None]]:
    """Show a progress bar of the flights in the context, on a terminal only; yield its update function (policy's name,
    steps done)."""
    with progress_bar("", policies * steps) as update:
        names: list[str] = []

        def told(name: str, step: int) -> None:
            """Show the policy that flies now and the steps done in the progress bar."""
            if name not in names:
                names.append(name)
            update(description=name, completed=(len(names) - 1) * steps + step)

        yield told
