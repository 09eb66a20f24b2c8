"""The vector environment of Stable-Baselines3, against the single ones that it would make itself."""

from __future__ import annotations

import sys
import warnings
from typing import Any

import numpy as np
import pytest

from qrsim.envs.single import SingleTask
from qrsim.errors import UsageError

INSTALL = "needs Stable-Baselines3: python -m pip install stable-baselines3"
SHORT: dict[str, Any] = {"extends": "keep_spot", "name": "three_steps", "duration": 0.06}
HOVER = np.array([0.0, 0.0, 0.0, 0.0, 1.0], np.float32)


def test_without_it_a_line_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "qrsim.envs.sb3", raising=False)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.vec_env", None)
    with pytest.raises(UsageError, match="needs Stable-Baselines3: python -m pip install"):
        __import__("qrsim.envs.sb3")


@pytest.mark.long
def test_it_is_what_its_own_vector_of_single_environments_is() -> None:
    pytest.importorskip("stable_baselines3", reason=INSTALL)
    from stable_baselines3.common.vec_env import DummyVecEnv

    from qrsim.envs.sb3 import VecTask

    ours, theirs = VecTask(SHORT, 2), DummyVecEnv([lambda: SingleTask(SHORT), lambda: SingleTask(SHORT)])
    for each in (ours, theirs):
        each.seed(5)
    np.testing.assert_allclose(ours.reset(), theirs.reset(), rtol=1e-5, atol=1e-5)
    totals = np.zeros(2)
    for step in range(7):
        found, expected = ours.step(np.stack([HOVER, HOVER])), theirs.step(np.stack([HOVER, HOVER]))
        totals = found[1] + (0.0 if step % 3 == 0 else totals)
        for got, wanted in zip(found[:3], expected[:3], strict=True):
            np.testing.assert_allclose(got, wanted, rtol=1e-4, atol=1e-4)
        for got, wanted, total in zip(found[3], expected[3], totals, strict=True):
            assert ("terminal_observation" in got) == ("terminal_observation" in wanted) == (step % 3 == 2)
            if step % 3 == 2:
                # Of three steps, as VecMonitor counts them.
                assert got["episode"]["l"] == 3
                assert got["episode"]["r"] == pytest.approx(total, rel=1e-5, abs=1e-8)
                assert got["TimeLimit.truncated"] is wanted["TimeLimit.truncated"] is True
                last = got["terminal_observation"], wanted["terminal_observation"]
                np.testing.assert_allclose(*last, rtol=1e-4, atol=1e-4)
                np.testing.assert_allclose(got["position_ned"], wanted["position_ned"], rtol=1e-4, atol=1e-4)
    with pytest.raises(UsageError, match="set_attr mass: all environments are one batch"):
        ours.set_attr("mass", 1.0)


@pytest.mark.long
def test_learners_take_it(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("stable_baselines3", reason=INSTALL)
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    from qrsim.envs.sb3 import VecTask

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        learner = PPO("MlpPolicy", VecNormalize(VecMonitor(VecTask(SHORT, 8))), n_steps=16, batch_size=64, seed=1)
        learner.learn(256)
        # Without a monitor: returns come from the environment itself.
        PPO("MlpPolicy", VecTask(SHORT, 8), n_steps=16, batch_size=64, seed=1, verbose=1).learn(128)
    assert learner.num_timesteps == 256
    shown = capsys.readouterr().out
    assert "ep_rew_mean" in shown
    assert "ep_len_mean" in shown
    # 256 steps of episodes of three.
    assert {episode["l"] for episode in learner.ep_info_buffer} == {3}
