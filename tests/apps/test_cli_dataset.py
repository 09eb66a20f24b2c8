"""``qrsim score --dataset``: what Minari reads back, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim import cli

pytestmark = pytest.mark.long

ID = "keep_spot/fall-v0"
# Without thrust it falls 10 m, in more than a second.
OWN = """
import numpy as np

def fall(seen):
    return np.tile([0.0, 0.0, -1.0, 0.0, 1.0], (len(seen), 1))
"""
SHORT = ["--seeds", "2", "--first-seed", "5", "--set", "duration=5", "--set", "task.crash=published"]


@pytest.fixture(autouse=True)
def _there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    Path("own.py").write_text(OWN, "utf-8")


def minari() -> Any:
    return pytest.importorskip("minari", reason="the extra 'datasets' is not installed")


def test_episodes_are_read_back(capsys: pytest.CaptureFixture[str]) -> None:
    """Lengths, seeds, actions and sums of rewards are those of the flights; flying the actions again gives the same."""
    gymnasium = pytest.importorskip("gymnasium")
    reader = minari()
    assert cli.main(["score", "keep_spot", "--policy", "own.py:fall", *SHORT, "--dataset", ID, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["dataset"] == str(Path("datasets", ID).resolve())
    data = reader.load_dataset(ID)
    assert (data.total_episodes, data.spec.env_spec.kwargs["overrides"]) == (2, [SHORT[5], SHORT[7]])
    assert data.storage.metadata["algorithm_name"] == "own.py:fall"
    episodes = list(data.iterate_episodes())
    assert [item["seed"] for item in data.storage.get_episode_metadata([0, 1])] == [5, 6]
    for episode, returned in zip(episodes, told["policies"][0]["returns"], strict=True):
        length = len(episode.rewards)
        assert episode.rewards.sum() == pytest.approx(returned, rel=1e-9)
        # It fell before the 250 steps were over.
        assert 50 < length < 250
        assert episode.observations.shape[0] == length + 1
        np.testing.assert_array_equal(episode.actions, np.tile([0.0, 0.0, -1.0, 0.0, 1.0], (length, 1)))
        assert episode.terminations.tolist() == [False] * (length - 1) + [True]
        assert not episode.truncations.any()
        assert all(len(leaf) == length + 1 for leaf in episode.infos.values())
    env = data.recover_environment()
    assert isinstance(env, gymnasium.Env)
    seen, truth = env.reset(seed=6)
    np.testing.assert_array_equal(seen, episodes[1].observations[0])
    for step in range(10):
        seen, reward, *_, truth = env.step(episodes[1].actions[step])
        np.testing.assert_allclose(seen, episodes[1].observations[step + 1], rtol=1e-4, atol=1e-4)
        assert reward == pytest.approx(episodes[1].rewards[step], rel=1e-3)
    name, leaf = next(iter(truth.items()))
    np.testing.assert_allclose(leaf, episodes[1].infos[name][10], rtol=1e-4, atol=1e-4)


def test_what_is_handed_in_is_in_the_last_reward(capsys: pytest.CaptureFixture[str]) -> None:
    reader = minari()
    more = ["--policy", "hover", "--seeds", "1", "--set", "duration=2"]
    assert cli.main(["score", "plume_mapping/3A", *more, "--dataset", "hover-v1", "--json"]) == 0
    returns = json.loads(capsys.readouterr().out)["policies"][0]["returns"]
    (episode,) = reader.load_dataset("hover-v1").iterate_episodes()
    assert episode.rewards.sum() == pytest.approx(returns[0], rel=1e-9)
    # Zeros for an answer cost the sum of squares of a concentration that is about 0.1 to 1 at 100 places.
    assert episode.rewards[-1] < -0.1
    assert (len(episode.rewards), bool(episode.truncations[-1]), bool(episode.terminations[-1])) == (2, True, False)


@pytest.mark.parametrize(
    ("task", "dataset", "message"),
    [
        ("cats_and_mouse/1A", "cats-v0", "--dataset: cats_and_mouse_1A has 3 agents; a dataset holds tasks with one"),
        ("keep_spot", "dive", "--dataset dive: expected an ID of Minari, NAME-vNUMBER or NAMESPACE/NAME-vNUMBER"),
        ("keep_spot", "a b-v0", "--dataset a b-v0: expected an ID of Minari"),
        ("keep_spot", "../dive-v0", "--dataset ../dive-v0: expected an ID of Minari"),
        ("keep_spot", "there-v0", "there-v0 exists already; take another name or version"),
    ],
)
def test_what_cannot_be_kept_is_refused(
    task: str, dataset: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    minari()
    Path("datasets/there-v0").mkdir(parents=True)
    assert cli.main(["score", task, *SHORT[:6], "--dataset", dataset]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert "Traceback" not in said
    assert said.strip().count("\n") == 0
    assert [path.name for path in Path("datasets").rglob("*")] == ["there-v0"]


def test_a_failed_writing_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    storage = pytest.importorskip("minari.dataset.minari_storage")

    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(storage.MinariStorage, "update_metadata", full)
    assert cli.main(["score", "keep_spot", *SHORT[:4], "--set", "duration=1", "--dataset", "full/a-v0"]) != 0
    assert not Path("datasets/full/a-v0").exists()
