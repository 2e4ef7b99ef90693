"""The names of what runs record. Loads nothing, so that commands can offer them."""

WINDOWS = ("budget-5%", "trailing-100")
"""What a point of a curve of returns averages: the last twentieth of the budget, or the last 100 episodes."""

EPISODE_QUANTITIES = ("return", "length", "kills", "hp")
"""Quantities of a training curve that average over episodes."""

ACTION_QUANTITIES = tuple(f"action_{i}" for i in range(5))

UPDATE_QUANTITIES = (
    "entropy",
    "grad_norm",
    "grad_norm_actor",
    "grad_norm_critic",
    "approx_kl",
    "explained_variance",
    "dead_units",
) + ACTION_QUANTITIES
"""Quantities that average over updates: columns of the metrics table."""

TRAINING_QUANTITIES = EPISODE_QUANTITIES + UPDATE_QUANTITIES

EVALUATION_QUANTITIES = ("share_killed", "score", "argmax_share_killed", "success", "evaluated_return")
"""Quantities of a curve over evaluations: columns of their table, which calls the last one return."""


def evaluation_column(quantity: str) -> str:
    return "return" if quantity == "evaluated_return" else quantity


TAGS = {
    "return": ("rollout/ep_rew_mean", "charts/episodic_return"),
    "length": ("rollout/ep_len_mean", "charts/episodic_length"),
    "policy_loss": ("train/policy_gradient_loss", "losses/policy_loss"),
    "value_loss": ("train/value_loss", "losses/value_loss"),
    "entropy": ("train/entropy_loss", "losses/entropy"),
    "approx_kl": ("train/approx_kl", "losses/approx_kl"),
    "clip_fraction": ("train/clip_fraction", "losses/clipfrac"),
    "explained_variance": ("train/explained_variance", "losses/explained_variance"),
}
NEGATED = "train/entropy_loss"

EVALUATION_TAGS = {
    "return": "eval/mean_reward",
    "length": "eval/mean_ep_length",
    "success": "eval/success_rate",
}
"""Stable-Baselines3's tags of some columns of the evaluations; others are called eval/COLUMN."""

CURVE_QUANTITIES = EVALUATION_QUANTITIES + TRAINING_QUANTITIES
