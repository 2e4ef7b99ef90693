"""The process's own random generators, which a user's code may draw from: seeded for a run, and kept.

Training has its own numbers, whatever was trained before in the process, and however often it is evaluated.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from pneuma.config import Run, is_gymnasium_id, stream_seed
from pneuma.env.fields import is_own_reward


def seed_shared_generators(run: Run, purpose: str = "shared") -> None:
    """Seed the generators of Python and NumPy, and those of torch and numba if a user's code may run."""
    seed = stream_seed(run.seed, purpose)
    if is_gymnasium_id(run.env) or any(map(is_own_reward, run.reward)):
        import torch  # which loads slowly: for a user's code alone

        from pneuma.env.compiling import seed_compiled

        torch.manual_seed(seed)
        seed_compiled(seed % 2**32)
    random.seed(seed)
    np.random.seed(seed % 2**32)


@contextmanager
def evaluation_generators(run: Run) -> Iterator[None]:
    """Seed the generators for an evaluation, and leave them as training needs them."""
    from pneuma.env.compiling import compiled_states, restore_compiled

    torch: Any = sys.modules.get("torch")
    python_state, numpy_state, states = random.getstate(), np.random.get_state(), compiled_states()
    torch_state = torch.get_rng_state() if torch else None
    device_states = torch.cuda.get_rng_state_all() if torch and torch.cuda.is_initialized() else []
    seed_shared_generators(run, "shared-evaluation")
    try:
        yield
    finally:
        random.setstate(python_state)
        np.random.set_state(numpy_state)
        restore_compiled(states)
        if torch:
            torch.set_rng_state(torch_state)
        if device_states:
            torch.cuda.set_rng_state_all(device_states)
