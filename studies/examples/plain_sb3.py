"""Compare a plain script of Stable-Baselines3 with Pneuma's two engines, in CartPole and in the arena.

    python studies/examples/plain_sb3.py --seeds 24

All three train PPO by the same settings, which are written once, by Stable-Baselines3's names. They draw
their random numbers otherwise, so that the same seed is another run in each. What is compared is the mean
return of the episodes that ended in the last quarter of the budget: means and deviations of all seeds, the
difference from the plain script with its 95 % interval, and the p-value of Welch's test. The figure shows
every seed.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import torch
from scipy import stats
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

from pneuma.config import Run, make_run
from pneuma.engines.loop import train_run
from pneuma.sb3_names import own_fields

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402

SETTINGS: dict[str, dict[str, Any]] = {
    "CartPole-v1": {  # rl-baselines3-zoo's
        "n_envs": 8, "n_steps": 32, "batch_size": 256, "n_epochs": 20, "gamma": 0.98, "gae_lambda": 0.8,
        "ent_coef": 0.0, "learning_rate": "lin_0.001", "clip_range": "lin_0.2",
        "policy_kwargs": {"net_arch": {"pi": [64, 64], "vf": [64, 64]}},
    },
    "pneuma/PneumaArena-v0": {  # the thesis's Table 6.2, but for Adam's betas
        "n_envs": 1, "n_steps": 256, "batch_size": 64, "n_epochs": 10, "gamma": 0.99, "gae_lambda": 0.95,
        "ent_coef": 0.01, "learning_rate": 3e-4, "clip_range": 0.1,
        "policy_kwargs": {"net_arch": {"pi": [128], "vf": [256]}},
    },
}  # fmt: skip
ARMS = ("plain", "sb3", "batched")


class Ended(BaseCallback):
    """Keeps step and return of every episode."""

    def __init__(self) -> None:
        super().__init__()
        self.episodes: list[tuple[int, float]] = []

    def _on_step(self) -> bool:
        ended = [info["episode"]["r"] for info in self.locals["infos"] if "episode" in info]
        self.episodes += [(self.num_timesteps, float(paid)) for paid in ended]
        return True


def schedule(value: Any) -> Any:
    """Return a number, or the function that rl-baselines3-zoo makes of lin_0.001."""
    if not isinstance(value, str):
        return value
    first = float(value.removeprefix("lin_"))
    return lambda left: first * left


def plain_learner(env: str, seed: int) -> PPO:
    """Return Stable-Baselines3's PPO as anybody would set it up; nothing here is Pneuma's but the arena."""
    settings = {key: schedule(value) for key, value in SETTINGS[env].items()}
    slots = make_vec_env(env, n_envs=settings.pop("n_envs"), seed=seed)
    return PPO("MlpPolicy", slots, seed=seed, device="cpu", **settings)


def run_of(env: str, seed: int, steps: int, engine: str) -> Run:
    """Return the same training as a run of an engine, evaluated as little as can be."""
    given = {"env": env, "seed": seed, "steps": steps, "engine": engine, "evaluation_episodes": 1}
    return make_run({**own_fields(SETTINGS[env]), **given})


def late_return(env: str, seed: int, steps: int, arm: str) -> float:
    """Train one seed; return the mean return of the episodes that ended in the last quarter."""
    run = run_of(env, seed, steps, "batched" if arm == "plain" else arm)
    if arm == "plain":
        ended = Ended()
        plain_learner(env, seed).learn(run.steps, callback=ended)
        episodes = ended.episodes
    else:
        result = train_run(run, lambda progress: True)
        episodes = [(row["step"], row["return"]) for row in result.records.episodes]
    return float(np.mean([paid for step, paid in episodes if step > 0.75 * run.steps]))


def measure(env: str, seeds: int, steps: int) -> dict[str, np.ndarray]:
    """Train all seeds of each arm, and tell how far it is."""
    returns: dict[str, list[float]] = {arm: [] for arm in ARMS}
    for seed in range(seeds):
        for arm in ARMS:
            returns[arm].append(late_return(env, seed, steps, arm))
        told = ", ".join(f"{arm} {values[-1]:.1f}" for arm, values in returns.items())
        print(f"{env} seed {seed}: {told}", flush=True)
    return {arm: np.array(values) for arm, values in returns.items()}


def report(env: str, returns: dict[str, np.ndarray]) -> None:
    print(f"{env}, mean return in the last quarter")
    for arm, values in returns.items():
        line = f"  {arm:8} {values.mean():8.2f} (sd {values.std(ddof=1):.2f}, n {len(values)})"
        if arm != "plain":
            test = stats.ttest_ind(values, returns["plain"], equal_var=False)
            low, high = test.confidence_interval()
            difference = values.mean() - returns["plain"].mean()
            line += f"  difference {difference:+.2f} [{low:+.2f}, {high:+.2f}], p = {test.pvalue:.2f}"
        print(line)


def draw(found: dict[str, dict[str, np.ndarray]], path: Path) -> None:
    figure, panels = plt.subplots(1, len(found), figsize=(8, 3.2), layout="constrained")
    for panel, (env, returns) in zip(panels, found.items(), strict=True):
        for place, values in enumerate(returns.values()):
            panel.plot(place + np.linspace(-0.15, 0.15, len(values)), np.sort(values), "o", ms=3, alpha=0.6)
            half = stats.sem(values) * stats.t.ppf(0.975, len(values) - 1)
            panel.errorbar(place, values.mean(), half, fmt="_k", ms=16, capsize=4)
        panel.set_xticks(range(len(returns)), returns)
        panel.set(title=env, ylabel="mean return in the last quarter")
    figure.savefig(path, dpi=150)


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--out", type=Path, default=Path("plain_sb3.png"))
    asked = parser.parse_args(words)
    if asked.seeds < 2:
        parser.error("--seeds: at least 2")
    torch.set_num_threads(1)
    found = {}
    for env in SETTINGS:
        found[env] = measure(env, asked.seeds, asked.steps)
        report(env, found[env])
    draw(found, asked.out)
    print(f"Drawn: {asked.out}")


if __name__ == "__main__":
    main()
