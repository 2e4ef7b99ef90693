"""The environment: a top-down world in which players fight monsters (thesis chapter 5).

`rules.py` contains the compiled rules, `layouts.py` and `observe.py` what a player perceives and `reward.py`
its rewards. `kernel.py` calls them, `worlds.py` owns the state, and `slots.py` makes each player a slot.
`gym.py`, `gym_vector.py`, `pettingzoo.py` and `sb3.py` are interfaces of other libraries, on `interface.py`.
"""

from pneuma.env.fields import ENVIRONMENTS


def register_environments() -> None:
    """Register all environments with Gymnasium, with vector environments for Pneuma's worlds.

    They are registered without a time limit, because worlds end their episodes themselves, by `episode_steps`
    (`pneuma.env.interface.Interface`).
    """
    import gymnasium  # which takes long, and registers them when it is imported

    for env_id in ENVIRONMENTS:
        gymnasium.register(
            env_id,
            entry_point="pneuma.env.gym:PneumaEnv",
            vector_entry_point="pneuma.env.gym_vector:PneumaVectorEnv",
            kwargs={"env_id": env_id},
        )
