"""The environment: a top-down world in which players fight monsters (thesis chapter 5).

`rules.py` holds the compiled kernels and `worlds.py` the state; `single.py`, `vector.py` and
`sb3.py` are the faces that other libraries know.
"""

import gymnasium

from pneuma.config import ENVIRONMENTS


def register_environments() -> None:
    """Make every environment known to Gymnasium, as single and as native vector environment."""
    for name in ENVIRONMENTS:
        gymnasium.register(
            name,
            entry_point="pneuma.env.single:PneumaEnv",
            vector_entry_point="pneuma.env.vector:PneumaVectorEnv",
        )
