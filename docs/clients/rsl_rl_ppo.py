import gymnasium
import torch
from pickenv.experiments import reaches_behind
from pickenv.base import run_seed
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

steps = 250_000


class Reaches(VecEnv):
    def __init__(self, count):
        kinds = {"plant": "ideal", "autoreset_mode": "SameStep"}
        self.envs = gymnasium.make_vec("pickenv:pickenv/ReachScaled-v0", num_envs=count, **kinds)
        self.num_envs, self.num_actions, self.device, self.cfg = count, 6, "cpu", {}
        self.max_episode_length, self.episode_length_buf = 60, torch.zeros(count, dtype=torch.long)
        self.seen = self.envs.reset(seed=run_seed(0))[0]

    def get_observations(self):
        return TensorDict({"policy": torch.tensor(self.seen)}, batch_size=self.num_envs)

    def step(self, actions):
        self.seen, rewards, ended, cut, _ = self.envs.step(actions.numpy())
        rewards, done, cut = torch.tensor(rewards).float(), torch.tensor(ended | cut), torch.tensor(cut)
        return self.get_observations(), rewards, done, {"time_outs": cut}


torch.manual_seed(0)
network = {"class_name": "MLPModel", "hidden_dims": [64, 64], "activation": "tanh"}
noise = {"class_name": "GaussianDistribution", "init_std": 0.37}
algorithm = {"class_name": "PPO", "gamma": 0.9, "lam": 0.9, "entropy_coef": 0.0}
tuned = {"num_steps_per_env": 60, "save_interval": 1000, "obs_groups": {"actor": ["policy"], "critic": ["policy"]}}
tuned |= {"actor": network | {"distribution_cfg": noise}, "critic": network, "algorithm": algorithm}
runner = OnPolicyRunner(Reaches(64), tuned)
runner.learn(steps // (64 * 60))
policy = runner.get_inference_policy()


def act(seen):
    with torch.no_grad():
        return policy({"policy": torch.as_tensor(seen)}).numpy()


for name, reaches in reaches_behind(act).items():
    print(f"{name}: {reaches.position_error_mm.mean():.2f} mm")
