"""How each quantity is drawn: its panel's title, the axis with its unit, and its scale."""

from __future__ import annotations

from dataclasses import dataclass

from pneuma.config import ACTION_NAMES


@dataclass(frozen=True)
class Look:
    """A quantity's panel.

    Attributes:
        title: of the panel.
        label: of its vertical axis.
        percent: whether it is a share, drawn from 0 up and in per cent.
        log: whether the axis is logarithmic.
    """

    title: str
    label: str
    percent: bool = False
    log: bool = False


def look_of(quantity: str, averaged_over: int | None = None) -> Look:
    """Return how a quantity of `CURVE_QUANTITIES` is drawn.

    Args:
        quantity: its name; one that is not known is drawn under it.
        averaged_over: episodes that each value of an episode's quantity was averaged over before.
    """
    look = _LOOKS.get(quantity) or Look(quantity.replace("_", " ").capitalize(), quantity.replace("_", " "))
    if averaged_over and look.label.endswith(_OF_AN_EPISODE):
        words = look.label.removesuffix(_OF_AN_EPISODE)
        return Look(look.title, f"{words}, mean of {averaged_over} episodes", look.percent, look.log)
    return look


_OF_AN_EPISODE = " of an episode"

_LOOKS = {
    "share_killed": Look("Monsters killed in evaluation", "Share killed", percent=True),
    "argmax_share_killed": Look(
        "Monsters killed, likeliest actions", "Share killed, likeliest actions", percent=True
    ),
    "score": Look("Normalised score in evaluation", "0 random player, 1 scripted hunter"),
    "return": Look("Return in training", "Return of an episode"),
    "length": Look("Length of episodes in training", "Steps of an episode"),
    "kills": Look("Monsters killed in training", "Kills of an episode"),
    "hp": Look("HP left in training", "HP at the end of an episode"),
    "entropy": Look("Entropy of the policy", "Entropy (nats)"),
    "grad_norm": Look("Gradient norm before clipping", "L2 norm", log=True),
    "grad_norm_actor": Look("Actor's gradient norm", "L2 norm", log=True),
    "grad_norm_critic": Look("Critic's gradient norm", "L2 norm", log=True),
    "explained_variance": Look("Variance of returns explained", "Explained variance of the critic"),
    "dead_units": Look("Dead hidden units", "Share of units", percent=True),
    **{
        f"action_{number}": Look(f"Share of action: {name}", "Share of actions", percent=True)
        for number, name in enumerate(ACTION_NAMES)
    },
}
