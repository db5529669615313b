import gymnasium
import torch
from evotorch.algorithms import PGPE
from evotorch.neuroevolution import VecGymNE
from pickenv.experiments import reaches_behind
from pickenv.base import run_seed

steps = 3_072_000
population, rate = 256, 0.1
torch.manual_seed(0)


def make(num_envs):  # one environment for each policy of a generation
    envs = gymnasium.make_vec("pickenv:pickenv/ReachScaled-v0", num_envs=num_envs, plant="ideal")
    envs.reset(seed=run_seed(0))
    return envs


problem = VecGymNE(make, "Linear(obs_length, 16) >> Tanh() >> Linear(16, act_length)")
search = PGPE(problem, popsize=population, center_learning_rate=rate, stdev_learning_rate=0.1, stdev_init=0.1)
for done in range(0, steps, population * 60):  # each policy reaches once, for a fruit of its own
    search.optimizer.param_groups[0]["lr"] = rate * (1 - done / steps)
    search.step()
policy = problem.to_policy(search.status["center"])


def act(seen):
    with torch.no_grad():
        return policy(torch.as_tensor(seen)).numpy()


for name, reaches in reaches_behind(act).items():
    print(f"{name}: {reaches.position_error_mm.mean():.2f} mm")
