"""Fly a policy of with_sb3.py in ``qrsim score``.

``qrsim score keep_spot --policy examples/learners/sb3_policy.py:Learned`` reads the file that ``with_sb3.py --out`` has
written, by default keep_spot_sb3.zip in the working folder. The variable SB3_POLICY names another one.
"""

import os

import numpy as np
from stable_baselines3 import PPO

from qrsim.envs import Functional
from qrsim.envs.learner import UNITS
from qrsim.envs.viewing import view_of
from qrsim.tasks.learned import LIMIT

MODEL = PPO.load(os.environ.get("SB3_POLICY", "keep_spot_sb3.zip"), device="cpu")
TASK = Functional.of("keep_spot")
VIEW = view_of(TASK)
# Unit of each input of the learner's view; the last action has none.
SCALE = np.array([*(UNITS.get(TASK.observation_axes[kept].unit, 1.0) for kept in VIEW.kept), *[1.0] * len(VIEW.flown)])


class Learned:
    """The mean action of the network, held between two decisions; made for each episode."""

    def __init__(self, play, seed):
        self.last = np.zeros((len(play.agents), len(VIEW.flown)), np.float32)
        self.hold, self.steps = round(VIEW.seconds / play.task.period), 0

    def act(self, seen):
        """Return the actions (n, A) in [-1, 1] for observations (n, O)."""
        if self.steps % self.hold == 0:
            inputs = (VIEW.features(np.asarray(seen), self.last) / SCALE).clip(-LIMIT, LIMIT)
            self.last = MODEL.predict(inputs.astype(np.float32), deterministic=True)[0].clip(-1.0, 1.0)
        self.steps += 1
        return VIEW.action(self.last)
