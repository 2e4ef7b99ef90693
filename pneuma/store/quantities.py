"""The quantities that runs record again and again: a row of `QUANTITIES` declares all that is known of one.

Loads nothing, so that commands can offer their names.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from pneuma.env.fields import ACTION_NAMES

WINDOWS = ("budget-5%", "trailing-100")
"""What a point of a curve of returns averages: the last twentieth of the budget, or the last 100 episodes."""
EPISODES, METRICS, EVALUATIONS = "episodes", "metrics", "evaluations"
"""The tables of records."""
VALUES, SHARES, POWERS = "values", "shares", "powers"
"""What an axis has: numbers, shares in per cent, or numbers on a logarithmic scale."""
POSITIVE = (0.0, math.inf)


@dataclass(frozen=True)
class Quantity:
    """One quantity.

    Attributes:
        table: the table of records that has it, of which `engines/records.py` lists the columns.
        title: of a panel with its curves; without one, only its tags are known.
        label: of the panel's axis.
        kind: of the axis. The curves of powers are rounded in proportion to each value.
        bounds: the least and greatest possible value, at which bands end.
        exact: the statistics of its whole curve that are kept with all digits.
        extreme: the extreme of all updates, 'least' or 'greatest', that is kept because means would hide it.
        published: whether a published table keeps its curve by default.
        words: what notes call its values; only of episodes.
        tags: in logs of Stable-Baselines3, and, unless it is of evaluations, of CleanRL. Those of episodes
            are of means over 100, and of single ones.
        column: its column, if that has another name.
    """

    table: str
    title: str = ""
    label: str = ""
    kind: str = VALUES
    bounds: tuple[float, float] = (-math.inf, math.inf)
    exact: tuple[str, ...] = ()
    extreme: str = ""
    published: bool = True
    words: str = ""
    tags: tuple[str, ...] = ()
    column: str = ""

    @property
    def title_with_unit(self) -> str:
        """The title, with the unit that the label has in brackets."""
        _, bracket, unit = self.label.partition(" (")
        return self.title + bracket + unit


def _share(
    table: str, title: str, label: str, exact: tuple[str, ...] = (), tags: tuple[str, ...] = ()
) -> Quantity:
    return Quantity(table, title, label, SHARES, (0, 1), exact, tags=tags)


QUANTITIES = {
    "return": Quantity(
        EPISODES, "Return in training", "Return of an episode", exact=("last", "best", "height"),
        words="returns in training", tags=("rollout/ep_rew_mean", "charts/episodic_return"),
    ),
    "length": Quantity(
        EPISODES, "Length of episodes in training", "Length of an episode (steps)", bounds=POSITIVE,
        exact=("last",), words="lengths of episodes",
        tags=("rollout/ep_len_mean", "charts/episodic_length"),
    ),
    "kills": Quantity(
        EPISODES, "Monsters killed in training", "Kills of an episode", bounds=POSITIVE,
        words="kills in training",
    ),
    "hp": Quantity(
        EPISODES, "HP left in training", "HP at the end of an episode", bounds=POSITIVE, exact=("last",),
        words="HP left in training",
    ),
    "policy_loss": Quantity(METRICS, tags=("train/policy_gradient_loss", "losses/policy_loss")),
    "value_loss": Quantity(METRICS, tags=("train/value_loss", "losses/value_loss")),
    "entropy": Quantity(
        METRICS, "Entropy of the policy", "Entropy (nats)", exact=("last",), extreme="least",
        tags=("train/entropy_loss", "losses/entropy"),
    ),
    "grad_norm": Quantity(
        METRICS, "Gradient norm, unclipped", "L2 norm", POWERS, exact=("median",), extreme="greatest",
    ),
    "grad_norm_actor": Quantity(METRICS, "Actor's gradient norm", "L2 norm", POWERS, published=False),
    "grad_norm_critic": Quantity(METRICS, "Critic's gradient norm", "L2 norm", POWERS, published=False),
    "approx_kl": Quantity(
        METRICS, "KL divergence", "KL divergence (nats)", exact=("average",), extreme="greatest",
        tags=("train/approx_kl", "losses/approx_kl"),
    ),
    "clip_fraction": Quantity(METRICS, tags=("train/clip_fraction", "losses/clipfrac")),
    "explained_variance": Quantity(
        METRICS, "Variance of returns explained", "Explained variance", exact=("early",),
        tags=("train/explained_variance", "losses/explained_variance"),
    ),
    "dead_units": _share(METRICS, "Dead hidden units", "Share of units", ("last",)),
    **{
        f"action_{number}": _share(METRICS, f"Share of action: {action}", "Share of actions", ("last",))
        for number, action in enumerate(ACTION_NAMES)
    },
    "share_killed": _share(EVALUATIONS, "Monsters killed in evaluation", "Share killed"),
    "score": Quantity(EVALUATIONS, "Normalised score in evaluation", "0 random player, 1 all killed"),
    "argmax_share_killed": _share(EVALUATIONS, "Monsters killed, likeliest actions", "Share killed"),
    "success": _share(
        EVALUATIONS, "Successes in evaluation", "Share of episodes", tags=("eval/success_rate",),
    ),
    "evaluated_return": Quantity(
        EVALUATIONS, "Return in evaluation", "Return of an episode", column="return",
        tags=("eval/mean_reward",),
    ),
    "evaluated_length": Quantity(EVALUATIONS, column="length", tags=("eval/mean_ep_length",)),
}  # fmt: skip
"""By name. Rows, panels and lists of names have their order."""


def _with_curves(table: str) -> tuple[str, ...]:
    return tuple(name for name, row in QUANTITIES.items() if row.table == table and row.title)


EPISODE_QUANTITIES = _with_curves(EPISODES)
"""Quantities of a training curve that average over episodes."""
UPDATE_QUANTITIES = _with_curves(METRICS)
"""Quantities that average over updates: columns of the metrics table."""
ACTION_QUANTITIES = tuple(name for name in UPDATE_QUANTITIES if name.startswith("action_"))
TRAINING_QUANTITIES = EPISODE_QUANTITIES + UPDATE_QUANTITIES
EVALUATION_QUANTITIES = _with_curves(EVALUATIONS)
"""Quantities of a curve over evaluations."""
CURVE_QUANTITIES = EVALUATION_QUANTITIES + TRAINING_QUANTITIES
PUBLISHED_CURVES = tuple(name for name in TRAINING_QUANTITIES if QUANTITIES[name].published)
"""The quantities whose curves a published table keeps by default."""


def evaluation_column(quantity: str) -> str:
    return QUANTITIES[quantity].column or quantity


# --- Tags of logs -----------------------------------------------------------------------------------

TAGS = {name: row.tags for name, row in QUANTITIES.items() if row.tags and row.table != EVALUATIONS}
"""Two of each quantity of training."""
NEGATED = "train/entropy_loss"
LOGGED_BY_EPISODE = tuple(name for name in EPISODE_QUANTITIES if name in TAGS)
"""Those that Stable-Baselines3 logs as means over 100 episodes."""
EVALUATION_TAGS = {
    evaluation_column(name): row.tags[0]
    for name, row in QUANTITIES.items()
    if row.tags and row.table == EVALUATIONS
}
"""Stable-Baselines3's tags of some columns of the evaluations; others are called eval/COLUMN."""
