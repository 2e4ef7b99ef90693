"""Train CartPole-v1 by Stable-Baselines3 alone, as rl-baselines3-zoo tuned its PPO.

Prints the return of 20 episodes with drawn actions after 100,000 steps, for each of ten seeds, and the mean:
something to set beside `cartpole.toml`.
"""

from statistics import mean

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy


def final_return(seed: int) -> float:
    """Return what one seed comes to; learning rate and clip range fall to nothing, as in the zoo."""
    model = PPO(
        "MlpPolicy",
        make_vec_env("CartPole-v1", n_envs=8, seed=seed),
        n_steps=32,
        batch_size=256,
        n_epochs=20,
        gamma=0.98,
        gae_lambda=0.8,
        ent_coef=0.0,
        learning_rate=lambda left: 1e-3 * left,
        clip_range=lambda left: 0.2 * left,
        seed=seed,
        device="cpu",
    )
    model.learn(100_000)
    fresh = make_vec_env("CartPole-v1", n_envs=1, seed=1000 + seed)
    return float(evaluate_policy(model, fresh, n_eval_episodes=20, deterministic=False)[0])


if __name__ == "__main__":
    torch.set_num_threads(1)
    returns = [final_return(seed) for seed in range(10)]
    print(*(f"{value:.0f}" for value in returns), f"mean {mean(returns):.1f}")
