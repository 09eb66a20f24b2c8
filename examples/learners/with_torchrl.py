"""PPO of TorchRL on keep_spot in the form for learners: with_torchrl.py 200000."""

import sys

import gymnasium
import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import qrsim.envs

STEPS, FRAMES, EPOCHS, MINIBATCH = int(sys.argv[1]) if len(sys.argv) > 1 else 200_000, 2048, 10, 64
torch.manual_seed(0)
env = GymWrapper(gymnasium.make(qrsim.envs.learner_id("keep_spot")))
env.set_seed(0)
inputs, outputs = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
means = nn.Sequential(MLP(inputs, 2 * outputs, num_cells=[64, 64], activation_class=nn.Tanh), NormalParamExtractor())
module = TensorDictModule(means, in_keys=["observation"], out_keys=["loc", "scale"])
limits = {"low": -1.0, "high": 1.0}
settings = {"distribution_class": TanhNormal, "distribution_kwargs": limits, "return_log_prob": True}
actor = ProbabilisticActor(module, in_keys=["loc", "scale"], spec=env.action_spec, **settings)
critic = ValueOperator(MLP(inputs, 1, num_cells=[64, 64], activation_class=nn.Tanh), in_keys=["observation"])
advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic)
loss = ClipPPOLoss(actor, critic, entropy_coeff=0.0, normalize_advantage=True)
adam = torch.optim.Adam(loss.parameters(), lr=3e-4)
for batch in Collector(env, actor, frames_per_batch=FRAMES, total_frames=max(FRAMES, STEPS)):
    for _ in range(EPOCHS):
        advantage(batch)
        for part in torch.randperm(FRAMES).split(MINIBATCH):
            found = loss(batch[part])
            sum(found[name] for name in ("loss_objective", "loss_critic")).backward()
            nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
            adam.step()
            adam.zero_grad()
    print(f"mean reward of a decision: {batch['next', 'reward'].mean().item():.4f}", flush=True)
