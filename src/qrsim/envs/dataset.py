"""Episodes of one agent as a dataset of Minari (https://minari.farama.org), for learning from recorded flights."""

from __future__ import annotations

import copy
import importlib.metadata
import shutil
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import jax
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.envs import ANY_TASK, SINGLE, gymnasium_id, register
from qrsim.envs.batch import Batch
from qrsim.errors import UsageError
from qrsim.extras import load

EXTRA, PURPOSE = "datasets", "a dataset of Minari"


@dataclass
class Recorded:
    """An episode of T steps: T + 1 observations and truths, of everything else T."""

    seen: list[object]
    truth: list[object]
    actions: list[Floats] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    terminated: list[bool] = field(default_factory=list)
    truncated: list[bool] = field(default_factory=list)


class Recording:
    """Keeps, in memory, what the agent of each episode of a batch sees, does and gets.

    Args:
        batch: of a task with one agent and no radio.

    Attributes:
        seeds: (B,) of the episodes.
        episodes: of each seed.

    Raises:
        UsageError: the task has several agents, or a radio.
    """

    def __init__(self, batch: Batch):
        name, agents = batch.functional.name, batch.functional.agents
        supported = "a dataset holds tasks with one agent and no radio"
        if len(agents) != 1:
            raise UsageError(f"--dataset: {name} has {len(agents)} agents; {supported}")
        if batch.functional.play.message:
            raise UsageError(f"--dataset: {name} has a radio; {supported}")
        self._batch = batch
        self.seeds = np.zeros(0, np.int64)
        self.episodes: list[Recorded] = []

    def begin(self) -> None:
        """Discard all recorded episodes, and record from the first step of the batch's present ones."""
        self.seeds = self._batch.seeds.copy()
        self.episodes = [Recorded([self._observation(row)], [self._truth_of(row)]) for row in range(self._batch.size)]

    def add(self, rows: Iterable[int], actions: Floats, reward: Floats, ended: tuple[Floats, Floats]) -> None:
        """Append one step of the episodes ``rows`` to their records.

        Args:
            rows: the episodes that were flown in it.
            actions: (B, 1, A).
            reward: (B, 1).
            ended: terminated and truncated, (B,) each.
        """
        for row in rows:
            episode = self.episodes[row]
            episode.seen.append(self._observation(row))
            episode.truth.append(self._truth_of(row))
            episode.actions.append(actions[row, 0].astype(self._batch.dtype))
            episode.rewards.append(float(reward[row, 0]))
            episode.terminated.append(bool(ended[0][row]))
            episode.truncated.append(bool(ended[1][row]))

    def score(self, row: int, number: float) -> None:
        """Add the score of an episode's answer to its last recorded reward, as the environments do."""
        self.episodes[row].rewards[-1] += number

    def _observation(self, row: int) -> object:
        """Return a copy of the agent's present observation in one episode."""
        return jax.tree.map(lambda leaf: np.array(leaf[row, 0]), self._batch.seen)

    def _truth_of(self, row: int) -> object:
        """Return a copy of the agent's present true values in one episode."""
        return {name: np.array(leaf[row, 0]) for name, leaf in self._batch.truth.items()}


def free_place(dataset: str) -> Path:
    """Return the folder for a new Minari dataset; raise UsageError if it exists or the name is invalid.

    Args:
        dataset: its ID, ``NAMESPACE/NAME-vNUMBER``; the namespace may be missing.

    Raises:
        MissingExtraError: Minari is not installed.
        UsageError: that is no ID, or there is such a dataset already.
    """
    parse = load(EXTRA, PURPOSE, "minari.dataset.minari_dataset").parse_dataset_id
    try:
        parse(dataset)
    except (ValueError, TypeError):
        raise UsageError(
            f"--dataset {dataset}: expected an ID of Minari, NAME-vNUMBER or NAMESPACE/NAME-vNUMBER, such as "
            "keep_spot/baseline-v0"
        ) from None
    place = Path(load(EXTRA, PURPOSE, "minari.storage").get_dataset_path(dataset))
    if place.exists():
        raise UsageError(f"--dataset {dataset}: {place} exists already; take another name or version")
    return place


def environment_spec(scenario: str, overrides: Iterable[str]) -> object:
    """Return Gymnasium's specification from which the environment of a scenario can be made again."""
    import gymnasium

    register()
    spec = copy.deepcopy(gymnasium.spec(gymnasium_id(scenario) if scenario in SINGLE else ANY_TASK))
    # A file is found again from any folder.
    spec.kwargs["scenario"] = str(Path(scenario).resolve()) if Path(scenario).is_file() else scenario
    if overrides := list(overrides):
        spec.kwargs["overrides"] = overrides
    return spec


def write(dataset: str, recording: Recording, policy: str, scenario: str, overrides: Iterable[str]) -> Path:
    """Write recorded episodes as a new Minari dataset, and return its folder.

    Infos are the truth by name; each episode has its seed, and the dataset the specification of its environment.

    Args:
        dataset: see ``free_place``.
        recording: what was flown.
        policy: who flew, Minari's ``algorithm_name``.
        scenario, overrides: of what ``environment_spec`` makes.

    Raises:
        MissingExtraError, UsageError: as of ``free_place``.
    """
    place = free_place(dataset)
    minari = load(EXTRA, PURPOSE, "minari")
    buffers = [
        minari.data_collector.EpisodeBuffer(
            id=number,
            seed=int(seed),
            observations=_stacked(episode.seen),
            actions=_stacked(episode.actions),
            rewards=episode.rewards,
            terminations=episode.terminated,
            truncations=episode.truncated,
            infos=_stacked(episode.truth) or None,
        )
        for number, (seed, episode) in enumerate(zip(recording.seeds, recording.episodes, strict=True))
    ]
    version = importlib.metadata.version("qrsim")
    try:
        with warnings.catch_warnings():
            # Of author, address and link, which are not known here.
            warnings.simplefilter("ignore", UserWarning)
            minari.create_dataset_from_buffers(
                dataset,
                buffers,
                env=environment_spec(scenario, overrides),
                algorithm_name=policy,
                description=f"qrsim {version}: {scenario} flown by {policy}",
                requirements=[f"qrsim=={version}"],
            )
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)
        raise
    return place


def _stacked(parts: Sequence[object]) -> object:
    """Return trees of arrays stacked along a new first axis."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *parts)
