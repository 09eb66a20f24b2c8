"""PPO of RLlib with its defaults on keep_spot in the form for learners: with_rllib.py --steps 200000."""

import argparse

import gymnasium
from ray.rllib.algorithms.ppo import PPOConfig
from ray.tune.registry import register_env

import qrsim.envs


def make(settings):
    """Return an environment; the import above registers it in every process of Ray."""
    return gymnasium.make(qrsim.envs.learner_id("keep_spot"), discount=settings["discount"])


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=200_000)
parser.add_argument("--seed", type=int, default=0)
asked = parser.parse_args()
register_env("keep_spot", make)
config = (
    PPOConfig()
    .environment("keep_spot", env_config={"discount": 0.99})
    .training(gamma=0.99)
    .env_runners(num_env_runners=0)
    .debugging(seed=asked.seed)
)
learner, steps = config.build_algo(), 0
while steps < asked.steps:
    runs = learner.train()["env_runners"]
    steps = int(runs["num_env_steps_sampled_lifetime"])
    print(f"{steps} steps: mean return of an episode {runs['episode_return_mean']:.3f}", flush=True)
learner.stop()
