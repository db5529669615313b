import gymnasium
import torch
from pickenv.experiments import reaches_behind
from pickenv.base import run_seed
from tensordict.nn import AddStateIndependentNormalScale, ProbabilisticTensorDictSequential, TensorDictModule
from torch.distributions import Independent, Normal
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper
from torchrl.modules import MLP, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

steps = 250_000
torch.manual_seed(0)
envs = gymnasium.make_vec("pickenv:pickenv/ReachScaled-v0", num_envs=64, plant="ideal", autoreset_mode="SameStep")
env = GymWrapper(envs)
env.set_seed(run_seed(0))
shape = {"num_cells": [64, 64], "activation_class": torch.nn.Tanh}
mean = MLP(13, 6, **shape)
body = torch.nn.Sequential(mean, AddStateIndependentNormalScale(6, scale_mapping="exp"))
torch.nn.init.constant_(body[1].state_independent_scale, -1.0)
actor = ProbabilisticActor(
    TensorDictModule(body, in_keys=["observation"], out_keys=["loc", "scale"]),
    in_keys=["loc", "scale"],
    distribution_class=lambda loc, scale: Independent(Normal(loc, scale), 1),
    return_log_prob=True,
)
critic = ValueOperator(MLP(13, 1, **shape), in_keys=["observation"])
loss = ClipPPOLoss(actor, critic, entropy_bonus=False, normalize_advantage=True, critic_coeff=0.5)
advantage = GAE(gamma=0.9, lmbda=0.9, value_network=critic)
optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
falling = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.01, steps // 3840)
for data in Collector(env, actor, frames_per_batch=3840, total_frames=steps // 3840 * 3840):
    for _ in range(5):
        with torch.no_grad():
            rows = advantage(data).reshape(-1)
        for part in torch.randperm(len(rows)).split(960):
            optimiser.zero_grad()
            values = loss(rows[part])
            (values["loss_objective"] + values["loss_critic"]).backward()
            torch.nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
            optimiser.step()
    falling.step()


def act(seen):
    with torch.no_grad():
        return mean(torch.as_tensor(seen)).numpy()


for name, reaches in reaches_behind(act).items():
    print(f"{name}: {reaches.position_error_mm.mean():.2f} mm")
