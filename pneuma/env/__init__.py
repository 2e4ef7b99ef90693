"""The environment: a top-down world in which players fight monsters (thesis chapter 5).

`rules.py` holds the compiled rules, `layouts.py` and `observe.py` what a player perceives and `reward.py`
what it is paid; `kernel.py` calls them, `worlds.py` owns the state, `slots.py` has the players one by one.
`gym.py`, `gym_vector.py`, `pettingzoo.py` and `sb3.py` are the faces that other libraries know.
"""

from typing import Any

import gymnasium
from gymnasium.envs.registration import WrapperSpec

from pneuma.algorithms import MAILMAN
from pneuma.config import GODOT
from pneuma.env_fields import ENVIRONMENTS, usual_episode_steps

MO_ENVIRONMENTS = tuple(name.replace("/", "/mo-") for name in ENVIRONMENTS)
"""The same worlds with vector rewards, for multi-objective learning."""

REGISTERED = (*ENVIRONMENTS, *MO_ENVIRONMENTS, MAILMAN)


class OfOneWorld(tuple[WrapperSpec, ...]):
    """Wrappers for `gymnasium.make`; to `make_vec`, which refuses any beside a vector environment, none."""

    def __len__(self) -> int:
        return 0


WITHOUT_TIME_LIMIT = OfOneWorld(
    [WrapperSpec("without_time_limit", "pneuma.env.gym:without_time_limit", kwargs={})]
)


def register_environments() -> None:
    """Register all environments with Gymnasium, with vector environments for Pneuma's worlds."""
    for name, mo_name in zip(ENVIRONMENTS, MO_ENVIRONMENTS, strict=True):
        limit: dict[str, Any] = {
            "max_episode_steps": usual_episode_steps(name), "additional_wrappers": WITHOUT_TIME_LIMIT
        }  # fmt: skip
        gymnasium.register(
            name,
            entry_point="pneuma.env.gym:PneumaEnv",
            vector_entry_point="pneuma.env.gym_vector:PneumaVectorEnv",
            kwargs={"env_id": name},
            **limit,
        )
        # Gymnasium's passive checker knows no vector rewards and would warn at the first step.
        gymnasium.register(
            mo_name,
            entry_point="pneuma.env.mo:PneumaMOEnv",
            vector_entry_point="pneuma.env.mo:PneumaMOVectorEnv",
            disable_env_checker=True,
            kwargs={"env_id": name},
            **limit,
        )
    gymnasium.register(MAILMAN, entry_point="pneuma.engines.mailman:MailmanEnv")
    gymnasium.register(GODOT, entry_point="pneuma.godot.game:GodotGame", disable_env_checker=True)
