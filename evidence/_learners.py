"""Stable-Baselines3's PPO with every setting at its default on registered tasks, several seeds of it: for training.py.

It runs in an environment of its own in the user's cache, made when it is first asked for, so that PyTorch stays out of
that of the project. Everything else there is the project's own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import venv
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from platformdirs import user_cache_path

from evidence import IMAGES, ROOT
from evidence.tasks import summary
from qrsim.envs.batch import Batch
from qrsim.envs.scoring import BASELINE, HOVER, maker, play_policy
from qrsim.errors import RunError
from qrsim.runs.picture import new_figure, save_picture

PACKAGES = ("torch==2.13.0", "stable-baselines3==2.9.2")
INSTALL = f"pip install {' '.join(PACKAGES)}"
# Seeds from here on are of episodes that nothing is learned from: those of the scores, and those of the curves.
NEW, TRIED = 10**6, 2 * 10**6


@dataclass(frozen=True)
class Study:
    """How a task is learned.

    Attributes:
        task: the scenario.
        learner: whether it is learned in its form for learners; scores are those of the task.
        scale: what rewards are multiplied by for the learner, by Gymnasium's ``TransformReward``; scores are not.
        most: steps at most.
        between: steps from one try to the next.
        tries: episodes of a try.
        until_whole: whether learning stops once all of these are flown to the end.
        trials: other episodes, those of the score.
        learners: how many, of the seeds from 0 on.
    """

    task: str
    learner: bool = False
    scale: float = 1.0
    most: int = 1_000_000
    between: int = 100_000
    tries: int = 100
    until_whole: bool = True
    trials: int = 200
    learners: int = 3


# Where a crash costs tens of thousands, the value that a learner expects would grow to that too slowly.
STUDIES = {
    "keep_spot": Study("keep_spot", learners=5),
    "keep_spot_learner": Study("keep_spot", learner=True, between=50_000, learners=5),
    "goto_waypoint": Study("goto_waypoint", scale=0.01, most=600_000),
}


def learned(name: str) -> dict[str, Any]:
    """Return how learners of several seeds do, with what hovering and the baseline score in the same episodes.

    Raises:
        RunError: a learner ends otherwise than by learning.
    """
    study, python = STUDIES[name], environment()
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        each = list(threads.map(lambda seed: _learner(python, study, seed), range(study.learners)))
    found: dict[str, Any] = {
        "learners": study.learners,
        "scale": study.scale,
        "most": study.most,
        "tries": study.tries,
        "trials": study.trials,
    }
    flown, seeds = Batch(study.task, study.trials), NEW + np.arange(study.trials)
    for policy in (HOVER, BASELINE):
        scored = play_policy(flown, policy, maker(policy, jax.tree.map(np.asarray, flown.functional.play)), seeds)
        found[policy] = summary(scored.returns, scored.alive)
    for seed, told in enumerate(each):
        total, alive = np.asarray(told.pop("returns")), np.asarray(told.pop("alive"))
        found[f"learner_{seed}"] = told | summary(total, alive)
    save_picture(lambda: draw(name, found), IMAGES / f"learning_{name}.png")
    return found


def _learner(python: Path, study: Study, seed: int) -> dict[str, Any]:
    """Return what a learner prints last."""
    words = [str(python), str(ROOT / "evidence" / "_ppo.py"), json.dumps(asdict(study) | {"seed": seed})]
    paths = os.pathsep.join([str(ROOT), str(ROOT / "src")])
    given = os.environ | {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(words, env=given, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        last: dict[str, Any] = {}
        for line in process.stdout:
            last = json.loads(line)
            if "returns" not in last:
                print(f"training: {study.task}, learner {seed}: {line.strip()}", flush=True)
    if process.returncode or "returns" not in last:
        raise RunError(f"training: learner {seed} of {study.task} ended with {process.returncode}")
    return last


def environment() -> Path:
    """Return the Python of an environment that has Stable-Baselines3 and all that the project has.

    Raises:
        RunError: it cannot be made.
    """
    folder = user_cache_path("qrsim") / f"learners-{sys.version_info[0]}.{sys.version_info[1]}"
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    asked = f"{sysconfig.get_path('purelib')}\n{' '.join(PACKAGES)}\n"
    done = folder / "made"
    if done.is_file() and done.read_text(encoding="utf-8") == asked:
        return python
    print(f"training: installing {' and '.join(PACKAGES)} in {folder}", flush=True)
    venv.create(folder, clear=True, with_pip=True)
    own = subprocess.run(
        [str(python), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()
    # Looked in after its own: what the project has is not installed a second time.
    Path(own, "project.pth").write_text(f"{sysconfig.get_path('purelib')}\n", encoding="utf-8")
    installed = subprocess.run([str(python), "-m", "pip", "install", "-q", *PACKAGES], check=False)
    if installed.returncode:
        raise RunError(f"training: cannot install Stable-Baselines3: {python} -m {INSTALL}")
    done.write_text(asked, encoding="utf-8")
    return python


def draw(name: str, found: dict[str, Any]) -> Any:
    """Draw the curves of a task, beside what hovering and the baseline score."""
    figure = new_figure(5.6, 3.6)
    axes = figure.subplots()
    for seed in range(found["learners"]):
        curve = found[f"learner_{seed}"]["curve"]
        steps = [int(step.removeprefix("step_")) / 1e6 for step in curve]
        axes.plot(steps, [each["mean"] for each in curve.values()], "o-", ms=3, lw=1.2, label=f"PPO, seed {seed}")
    for policy, label, style in ((HOVER, "hovering", ":"), (BASELINE, "baseline", "--")):
        axes.axhline(found[policy]["mean"], color="black", ls=style, lw=1.0, label=label)
    axes.set_yscale("symlog", linthresh=1.0)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_ylim(top=0.0)
    axes.set_xlabel("steps of agents [10^6]")
    axes.set_ylabel(f"mean return of {found['tries']} new episodes")
    form = ", form for learners" if STUDIES[name].learner else ""
    axes.set_title(f"{STUDIES[name].task}{form}: PPO of Stable-Baselines3 with its defaults", fontsize=10)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return figure
