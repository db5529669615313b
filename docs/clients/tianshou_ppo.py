import gymnasium
import torch
from pickenv.experiments import reaches_behind
from pickenv.base import run_seed
from tianshou.algorithm import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory, LRSchedulerFactoryLinear
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OnPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic
from torch.distributions import Independent, Normal

steps = 100_000
torch.manual_seed(0)
envs = DummyVectorEnv([lambda: gymnasium.make("pickenv:pickenv/ReachScaled-v0", plant="ideal") for _ in range(64)])
envs.seed(run_seed(0))
net = {"state_shape": 13, "hidden_sizes": (64, 64), "activation": torch.nn.Tanh}
actor = ContinuousActorProbabilistic(preprocess_net=Net(**net), action_shape=6, unbounded=True)
torch.nn.init.constant_(actor.sigma_param, -1.0)
critic = ContinuousCritic(preprocess_net=Net(**net))
rounds = steps // 3840
falling = LRSchedulerFactoryLinear(1, rounds * 3840, 3840)
algorithm = PPO(
    policy=ProbabilisticActorPolicy(
        actor=actor,
        dist_fn=lambda found: Independent(Normal(*found), 1),
        action_space=envs.action_space[0],
        action_scaling=False,
        action_bound_method=None,  # the environment cuts actions itself
    ),
    critic=critic,
    optim=AdamOptimizerFactory(lr=1e-3).with_lr_scheduler_factory(falling),
    gamma=0.9,
    gae_lambda=0.9,
    ent_coef=0.0,
    max_grad_norm=0.5,
)
algorithm.run_training(
    OnPolicyTrainerParams(
        training_collector=Collector(algorithm, envs, VectorReplayBuffer(3840, 64)),
        max_epochs=1,
        epoch_num_steps=rounds * 3840,
        collection_step_num_env_steps=3840,
        update_step_num_repetitions=5,
        batch_size=960,
        test_in_training=False,
        show_progress=False,
    )
)


def act(seen):
    with torch.no_grad():
        return actor(torch.as_tensor(seen))[0][0].numpy()


for name, reaches in reaches_behind(act).items():
    print(f"{name}: {reaches.position_error_mm.mean():.2f} mm")
