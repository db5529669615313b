import gymnasium
import torch
from pickenv.experiments import reaches_behind
from pickenv.base import run_seed
from torch.distributions import Normal

steps = 250_000
count, length = 64, 60
torch.manual_seed(0)
envs = gymnasium.make_vec("pickenv:pickenv/ReachScaled-v0", num_envs=count, plant="ideal", autoreset_mode="Disabled")
actor, critic = (
    torch.nn.Sequential(*[each for n in (13, 64) for each in (torch.nn.Linear(n, 64), torch.nn.Tanh())]).append(
        torch.nn.Linear(64, outputs)
    )
    for outputs in (6, 1)
)
log_std = torch.nn.Parameter(torch.full((6,), -1.0))
weights = [*actor.parameters(), *critic.parameters(), log_std]
optimiser = torch.optim.Adam(weights, lr=1e-3)
rounds = steps // (count * length)
falling = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.01, rounds)
for number in range(rounds):  # each round is one episode of 60 steps in every environment
    rows, seen = [], torch.as_tensor(envs.reset(seed=None if number else run_seed(0))[0])
    for _ in range(length):
        with torch.no_grad():
            action = Normal(actor(seen), log_std.exp()).sample()  # goes beyond 1; the environment cuts it
            chance, value = Normal(actor(seen), log_std.exp()).log_prob(action).sum(-1), critic(seen)[:, 0]
        after, reward, *_ = envs.step(action.numpy())
        rows.append((seen, action, chance, value, torch.as_tensor(reward).float()))
        seen = torch.as_tensor(after)
    observations, actions, chances, values, rewards = map(torch.stack, zip(*rows, strict=True))
    with torch.no_grad():  # cut by time: the last step is worth what would have come
        following, gain, gains = critic(seen)[:, 0], torch.zeros(count), torch.zeros_like(rewards)
        for i in reversed(range(length)):
            gain = rewards[i] + 0.9 * following - values[i] + 0.9 * 0.9 * gain
            gains[i], following = gain, values[i]
    flat = [each.flatten(0, 1) for each in (observations, actions, chances, gains, gains + values)]
    for _ in range(5):
        for part in torch.randperm(count * length).split(960):
            each, taken, before, better, worth = (numbers[part] for numbers in flat)
            ratio = (Normal(actor(each), log_std.exp()).log_prob(taken).sum(-1) - before).exp()
            better = (better - better.mean()) / (better.std() + 1e-8)
            loss = -torch.minimum(ratio * better, ratio.clip(0.8, 1.2) * better).mean()
            loss = loss + 0.5 * (critic(each)[:, 0] - worth).square().mean()
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(weights, 0.5)
            optimiser.step()
    falling.step()


def act(seen):
    with torch.no_grad():
        return actor(torch.as_tensor(seen)).numpy()


for name, reaches in reaches_behind(act).items():
    print(f"{name}: {reaches.position_error_mm.mean():.2f} mm")
