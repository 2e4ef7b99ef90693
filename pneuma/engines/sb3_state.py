"""The whole state of a Stable-Baselines3 learner between two updates, as plain arrays, and back.

Its own `save` leaves out environment, random generators and last observation, and its `load` runs
pickled code. Here everything that the next update reads is taken, and nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from stable_baselines3 import DQN

from pneuma.engines.checkpoint import Checkpoint, CheckpointError
from pneuma.engines.records import Records
from pneuma.engines.sb3_learners import Learner
from pneuma.env.sb3 import PneumaVecEnv


def take_checkpoint(model: Learner, step: int, records: Records) -> Checkpoint:
    """Copy all that the next update depends on."""
    env = model.env
    assert isinstance(env, PneumaVecEnv)
    kind, keys, position, has_gauss, gauss = np.random.get_state(legacy=True)
    arrays = {
        **{f"policy/{name}": _copy(tensor) for name, tensor in model.policy.state_dict().items()},
        **_optimizer_arrays(model.policy.optimizer),
        **{f"worlds/{name}": array for name, array in env.saved_state().items()},
        "random/torch": torch.get_rng_state().numpy().copy(),
        "random/numpy": np.asarray(keys).copy(),
        "last/observations": np.array(model._last_obs),
        "last/episode_starts": np.array(model._last_episode_starts),
        **(_replay_arrays(model) if isinstance(model, DQN) else {}),
    }
    numbers = {
        "numpy": [str(kind), int(position), int(has_gauss), float(gauss)],
        "optimizer": type(model.policy.optimizer).__name__,
        "updates": int(model._n_updates),
        "timesteps": int(model.num_timesteps),
        **(_exploration_numbers(model) if isinstance(model, DQN) else {}),
    }
    return Checkpoint(step, arrays, numbers, records.copy())


def restore_checkpoint(model: Learner, checkpoint: Checkpoint, left_out: Sequence[str] = ()) -> None:
    """Put a learner, and torch's and NumPy's global generators, where a checkpoint was taken.

    Arrays whose names begin with one of `left_out` stay as the learner has them.

    Raises:
        CheckpointError: for one that does not fit this learner.
    """
    env = model.env
    assert isinstance(env, PneumaVecEnv)
    numbers = checkpoint.numbers
    arrays = {k: v for k, v in checkpoint.arrays.items() if not k.startswith(tuple(left_out))}
    try:
        kept = any(name.startswith("optimizer/") for name in arrays)
        if kept and numbers["optimizer"] != type(model.policy.optimizer).__name__:
            raise ValueError(f"it is of the optimizer {numbers['optimizer']}")
        model.policy.load_state_dict({**model.policy.state_dict(), **_tensors(arrays, "policy/")})
        _restore_optimizer(model.policy.optimizer, arrays)
        worlds = {name: arrays[f"worlds/{name}"] for name in env.saved_state()}
        env.restore_state(worlds)
        torch.set_rng_state(torch.tensor(arrays["random/torch"]))
        kind, position, has_gauss, gauss = numbers["numpy"]
        np.random.set_state((kind, arrays["random/numpy"].copy(), position, has_gauss, gauss))
        model._last_obs = arrays["last/observations"].copy()
        model._last_episode_starts = arrays["last/episode_starts"].copy()
        model._n_updates, model.num_timesteps = numbers["updates"], numbers["timesteps"]
        if isinstance(model, DQN):
            _restore_replay(model, arrays, numbers)
    except (KeyError, ValueError, TypeError, RuntimeError) as error:
        raise CheckpointError(f"cannot go on from step {checkpoint.step:,}: {error}") from None


_REPLAYED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def _replay_arrays(model: DQN) -> dict[str, np.ndarray]:
    """Copy the part of DQN's replay buffer that holds something."""
    buffer = model.replay_buffer
    assert buffer is not None
    return {f"replay/{name}": getattr(buffer, name)[: buffer.size()].copy() for name in _REPLAYED}


def _exploration_numbers(model: DQN) -> dict[str, Any]:
    """Return where DQN's buffer, schedules and stream of random actions stand."""
    assert model.replay_buffer is not None
    return {
        "position": int(model.replay_buffer.pos),
        "full": bool(model.replay_buffer.full),
        "calls": int(model._n_calls),
        "exploration": float(model.exploration_rate),
        "random_actions": model.action_space.np_random.bit_generator.state,
    }


def _restore_replay(model: DQN, arrays: Mapping[str, np.ndarray], numbers: Mapping[str, Any]) -> None:
    buffer = model.replay_buffer
    assert buffer is not None
    for name in _REPLAYED:
        getattr(buffer, name)[: len(arrays[f"replay/{name}"])] = arrays[f"replay/{name}"]
    buffer.pos, buffer.full = numbers["position"], numbers["full"]
    model._n_calls, model.exploration_rate = numbers["calls"], numbers["exploration"]
    model.action_space.np_random.bit_generator.state = numbers["random_actions"]


def critic_names(model: Learner) -> tuple[str, ...]:
    """Return how the names of all arrays of the critic begin, its optimizer's among them."""
    named = [name for name, _ in model.policy.named_parameters()]
    critic = [name for name in named if "value_net" in name]
    return (*(f"policy/{name}" for name in critic), *(f"optimizer/{named.index(name)}/" for name in critic))


def _copy(tensor: torch.Tensor) -> np.ndarray:
    return np.array(tensor.detach().numpy())


def _tensors(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, torch.Tensor]:
    """Return the arrays of a prefix as tensors in memory of torch's own, aligned as its kernels like it."""
    return {
        name.removeprefix(prefix): torch.tensor(array)
        for name, array in arrays.items()
        if name.startswith(prefix)
    }


def _optimizer_arrays(optimizer: torch.optim.Optimizer) -> dict[str, np.ndarray]:
    """Return what an optimizer keeps of every parameter: optimizer/INDEX/NAME."""
    state: dict[int, dict[str, Any]] = optimizer.state_dict()["state"]
    return {
        f"optimizer/{index}/{name}": _copy(torch.as_tensor(value))
        for index, kept in state.items()
        for name, value in kept.items()
        if value is not None
    }


def _restore_optimizer(optimizer: torch.optim.Optimizer, arrays: Mapping[str, np.ndarray]) -> None:
    state: dict[int, dict[str, torch.Tensor]] = {}
    for path, tensor in _tensors(arrays, "optimizer/").items():
        index, _, name = path.partition("/")
        state.setdefault(int(index), {})[name] = tensor
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
