"""PPO in one file of PyTorch, in the style of CleanRL, on keep_spot in the form for learners."""

import sys

import gymnasium
import numpy as np
import torch
from torch import nn

import qrsim.envs

STEPS, ENVS, HORIZON, GAMMA, LAMBDA = int(sys.argv[1]) if len(sys.argv) > 1 else 200_000, 8, 256, 0.99, 0.95
torch.manual_seed(1)
envs = gymnasium.make_vec(qrsim.envs.learner_id("keep_spot"), num_envs=ENVS)
inputs, outputs = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
actor, critic = (nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, n)) for n in (outputs, 1))
spread = nn.Parameter(torch.full((outputs,), -0.5))
adam = torch.optim.Adam([*actor.parameters(), *critic.parameters(), spread], lr=1e-3)
seen, ended = torch.tensor(envs.reset(seed=1)[0]), np.zeros(ENVS, bool)
for _ in range(max(1, STEPS // (ENVS * HORIZON))):
    rows = []
    for _ in range(HORIZON):
        with torch.no_grad():
            policy = torch.distributions.Normal(actor(seen), spread.exp())
            action, value = policy.sample(), critic(seen)[:, 0]
            density = policy.log_prob(action).sum(1)
            after, reward, crashed, cut, _ = envs.step(action.clip(-1, 1).numpy())
            after = torch.tensor(after)
            beyond = torch.where(torch.tensor(crashed), 0.0, critic(after)[:, 0])
        # A step after an end only starts the next episode: it counts for nothing.
        rows.append((seen, action, density, value, torch.tensor(reward), beyond, torch.tensor(crashed | cut), ended))
        seen, ended = after, crashed | cut
    gain, later = [], torch.zeros(ENVS)
    for _, _, _, value, reward, beyond, over, _ in reversed(rows):
        later = reward.float() + GAMMA * beyond - value + GAMMA * LAMBDA * ~over * later
        gain.insert(0, later)
    used = ~torch.tensor(np.stack([row[7] for row in rows])).flatten()
    x, a, old, values = (torch.cat([row[i] for row in rows])[used] for i in range(4))
    advantage = torch.cat(gain)[used]
    target = advantage + values
    for _ in range(10):
        for part in torch.randperm(len(x)).split(256):
            policy = torch.distributions.Normal(actor(x[part]), spread.exp())
            ratio = (policy.log_prob(a[part]).sum(1) - old[part]).exp()
            scaled = (advantage[part] - advantage[part].mean()) / (advantage[part].std() + 1e-8)
            loss = -torch.min(ratio * scaled, ratio.clip(0.8, 1.2) * scaled).mean()
            loss = loss + 0.5 * (critic(x[part])[:, 0] - target[part]).square().mean()
            adam.zero_grad()
            loss.backward()
            adam.step()
    print(f"mean reward of a decision: {torch.stack([row[4] for row in rows]).mean():.4f}", flush=True)
