"""Several players' policies, each its own: what independent learners leave behind."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pneuma.engines.policy import Policy, read_sound_policy
from pneuma.errors import UserError

if TYPE_CHECKING:
    from pneuma.env.worlds import Worlds

SHARED_FILE = "policy.safetensors"


@dataclass(frozen=True)
class Team:
    """One policy for each player of a world, in the players' order; acts as a `Policy` does.

    Row i of observations is player i % players of world i // players.
    """

    policies: tuple[Policy, ...]

    def sample(self, observations: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """Draw an action for each observation, player by player: (N, features) -> (N,)."""
        return self._each(observations, lambda policy, own: policy.sample(own, generator))

    def best(self, observations: np.ndarray) -> np.ndarray:
        """Return the most probable action for each observation: (N, features) -> (N,)."""
        return self._each(observations, lambda policy, own: policy.best(own))

    def _each(self, observations: np.ndarray, act: Callable[[Policy, np.ndarray], np.ndarray]) -> np.ndarray:
        actions = np.zeros(len(observations), np.int64)
        for player, policy in enumerate(self.policies):
            own = slice(player, None, len(self.policies))
            actions[own] = act(policy, observations[own])
        return actions


def drawing(
    policy: Policy | Team, worlds: Worlds, generator: np.random.Generator
) -> Callable[[Worlds], np.ndarray]:
    """Return what draws actions, (N, P), from a stored policy in worlds.

    Raises:
        UserError: as `check_fits` does.
    """
    check_fits(policy, worlds)

    def act(shown: Worlds) -> np.ndarray:
        flat = shown.observations.reshape(-1, shown.observations.shape[2])
        return policy.sample(flat, generator).reshape(shown.players.shape)

    return act


def check_fits(policy: Policy | Team, worlds: Worlds) -> None:
    """Check that a stored policy can play in worlds.

    Raises:
        UserError: where it was trained on something else than these worlds are.
    """
    policies = policy.policies if isinstance(policy, Team) else (policy,)
    players = worlds.players.shape[1]
    for what, trained, here in (
        ("features", len(policies[0].actor[0][0]), worlds.observations.shape[2]),
        ("actions", len(policies[0].actor[-1][1]), int(worlds.action_space.n)),
        ("players", len(policies) if len(policies) > 1 else players, players),
    ):
        if trained != here:
            raise UserError(f"was trained on {trained} {what}; these settings make {here}")


def policy_files(policy: Policy | Team) -> dict[str, bytes]:
    """Return a policy's file by name, or one for each player."""
    if isinstance(policy, Policy):
        return {SHARED_FILE: policy.to_bytes()}
    return {policy_file(player): own.to_bytes() for player, own in enumerate(policy.policies)}


def policy_file(player: int) -> str:
    """Return the name of the file of a player's own policy."""
    return f"policy-{player}.safetensors"


def policy_names(files: Collection[str]) -> list[str]:
    """Return which of a run's files hold its policy: one, or the players' in their order."""
    if SHARED_FILE in files:
        return [SHARED_FILE]
    players = range(sum(name.startswith("policy-") for name in files))
    return [policy_file(player) for player in players if policy_file(player) in files]


def read_policies(contents: list[bytes]) -> Policy | Team:
    """Read the contents of `policy_names` back.

    Raises:
        UserError: for what is no policy.
    """
    policies = tuple(read_sound_policy(data) for data in contents)
    return policies[0] if len(policies) == 1 else Team(policies)
