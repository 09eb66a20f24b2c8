"""PPO of Stable-Baselines3 with its defaults on keep_spot in the form for learners: with_sb3.py --steps 200000.

``--out`` keeps the policy, which sb3_policy.py flies in ``qrsim score``.
"""

import argparse
import json

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor

import qrsim.envs


def main() -> None:
    """Train, then fly new episodes by the mean action, and print the part flown to the end and the published return."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--out", help="file to write, such as keep_spot_sb3.zip")
    asked = parser.parse_args()
    env = Monitor(gymnasium.make(qrsim.envs.learner_id("keep_spot")))
    model = PPO("MlpPolicy", env, seed=asked.seed, device="cpu")
    model.learn(asked.steps)
    if asked.out:
        model.save(asked.out)
    returns, whole = np.zeros(asked.episodes), np.zeros(asked.episodes, bool)
    for episode in range(asked.episodes):
        seen, _ = env.reset(seed=10**6 + episode)
        terminated = truncated = False
        while not (terminated or truncated):
            action, _ = model.predict(seen, deterministic=True)
            seen, _, terminated, truncated, info = env.step(action)
            returns[episode] += info["task_reward"]
        whole[episode] = truncated
    print(json.dumps({"flown_to_the_end": whole.mean(), "mean_return": returns.mean()}))


if __name__ == "__main__":
    main()
