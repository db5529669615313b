import gymnasium
import torch
from pickenv.experiments import reaches_behind
from pickenv.base import run_seed
from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from skrl.utils import set_seed

steps, epochs = 250_000, 5
set_seed(run_seed(0))
env = wrap_env(gymnasium.make_vec("pickenv:pickenv/ReachScaled-v0", num_envs=64, plant="ideal"))
spaces = {"observation_space": env.observation_space, "action_space": env.action_space, "device": "cpu"}


def network(outputs):
    layers = torch.nn.Linear(13, 64), torch.nn.Tanh(), torch.nn.Linear(64, 64), torch.nn.Tanh()
    return torch.nn.Sequential(*layers, torch.nn.Linear(64, outputs))


class Actor(GaussianMixin, Model):
    def __init__(self):
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)  # clip_actions=False, as it is by default
        self.network, self.log_std = network(6), torch.nn.Parameter(torch.full((6,), -1.0))

    def compute(self, inputs, role):
        return self.network(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    def __init__(self):
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.network = network(1)

    def compute(self, inputs, role):
        return self.network(inputs["observations"]), {}


models = {"policy": Actor(), "value": Critic()}
updates = steps // (64 * 60) * epochs
tuned = {"rollouts": 60, "learning_epochs": epochs, "mini_batches": 4, "discount_factor": 0.9, "gae_lambda": 0.9}
tuned |= {"learning_rate": 1e-3, "learning_rate_scheduler": torch.optim.lr_scheduler.LinearLR}
tuned |= {"learning_rate_scheduler_kwargs": {"start_factor": 1.0, "end_factor": 0.01, "total_iters": updates}}
tuned |= {"time_limit_bootstrap": True, "value_loss_scale": 0.5}
tuned |= {"experiment": {"write_interval": 0, "checkpoint_interval": 0}}
agent = PPO(models=models, memory=RandomMemory(memory_size=60, num_envs=64), cfg=tuned, **spaces)
SequentialTrainer(env=env, agents=agent, cfg={"timesteps": steps // 64, "headless": True}).train()


def act(seen):
    with torch.no_grad():
        return models["policy"].network(torch.as_tensor(seen)).numpy()


for name, reaches in reaches_behind(act).items():
    print(f"{name}: {reaches.position_error_mm.mean():.2f} mm")
