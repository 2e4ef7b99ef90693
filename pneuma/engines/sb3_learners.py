"""Learners of Stable-Baselines3 and sb3-contrib for a run: PPO, A2C, TRPO, DQN and Double DQN.

The learners are the libraries' own. Pneuma adds two classes: the target of Double DQN, and advantages without
a baseline.

This module also reads and restores a learner's complete state between two updates, as plain arrays. The
library's `save` leaves out environment, random generators and last observation, and its `load` runs pickled
code.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from inspect import signature
from typing import Any

import numpy as np
import torch
from sb3_contrib import TRPO
from stable_baselines3 import A2C, DQN, PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from pneuma.algorithms import OPTIMIZERS
from pneuma.config import ACTIVATIONS, ANNEALED, CUDA, FIELDS, LIBRARY, Run, is_gymnasium_id, stream_seed
from pneuma.engines.records import Checkpoint, Records, Row, episode_row
from pneuma.engines.stopping import IsStopping, check_stop, never

Learner = PPO | A2C | TRPO | DQN


def make_model(run: Run, env: VecEnv, extractor: Mapping[str, Any] | None = None) -> Any:
    """Set up a run's learner, one of `Learner`.

    The global generators of torch and NumPy have separate streams. Torch's gives the initial weights, then
    the actions, and the start of TRPO's conjugate gradient; NumPy's gives the minibatches, and whether DQN
    explores. DQN's action space samples its random actions.

    Args:
        run: the run.
        env: its environments.
        extractor: additional `policy_kwargs`.
    """
    is_library_seed = run.seed_as == LIBRARY
    torch.manual_seed(stream_seed(run.seed, "weights"))
    arguments = learner_arguments(run, env.num_envs)
    arguments["policy_kwargs"] |= extractor or {}
    if is_library_seed:  # the learner seeds all generators, and its environments
        arguments["seed"] = run.seed
    model = LEARNERS[run.algorithm](policy="MlpPolicy", env=env, device=run.device, **arguments)
    if run.first_layer_scale != 1:
        with torch.no_grad():
            for layers in linear_layers(model).values():
                layers[0].weight.mul_(run.first_layer_scale)
    if is_library_seed:
        return model
    torch.manual_seed(stream_seed(run.seed, "actions"))
    np.random.seed(stream_seed(run.seed, "minibatches") % 2**32)
    if isinstance(model, DQN):
        model.action_space.seed(stream_seed(run.seed, "random-actions"))
    return model


def learner_arguments(run: Run, slots: int) -> dict[str, Any]:
    """Return the arguments of a learner of `LEARNERS` that follow from a run's fields."""
    arguments: dict[str, Any] = {}
    for argument, field_name in field_arguments(run):
        arguments[argument] = getattr(run, field_name)
        if field_name in ANNEALED and getattr(run, f"{field_name}_schedule") == "linear":
            arguments[argument] = LinearSchedule(arguments[argument], 0.0, 1.0)
    net_arch: Any = list(run.actor)
    if issubclass(LEARNERS[run.algorithm], DQN):
        assert run.target_every
        arguments["target_update_interval"] = max(run.target_every, slots)  # at least a step of all slots
    else:
        net_arch = {"pi": list(run.actor), "vf": list(run.critic)}
        arguments["rollout_buffer_class"] = None if run.value_baseline else WithoutBaseline
    if "max_grad_norm" in arguments and (run.gradient_limit is None or run.clip != "joint"):
        arguments["max_grad_norm"] = float("inf")
    # Stable-Baselines3 uses epsilon 1e-5 only if no optimizer arguments are given, otherwise torch's 1e-8
    optimizer = OPTIMIZERS[run.optimizer]
    optimizer_arguments = {"weight_decay": run.weight_decay}
    for field_name in optimizer.defaults:
        (argument,) = FIELDS[field_name].arguments or (field_name,)
        optimizer_arguments[argument] = getattr(run, field_name)
    arguments["policy_kwargs"] = {
        "net_arch": net_arch,
        "activation_fn": getattr(nn, ACTIVATIONS[run.activation]),
        "optimizer_class": getattr(torch.optim, optimizer.torch_class),
        "optimizer_kwargs": optimizer_arguments,
    }
    return arguments


def linear_layers(model: Any) -> dict[str, list[nn.Linear]]:
    """Return the layers of a learner's networks, as `Policy` names these; the last one is the output."""
    policy = model.policy
    if isinstance(model, DQN):
        return {"actor": _linear(policy.q_net.q_net)}
    hidden_networks = policy.mlp_extractor
    return {
        "actor": [*_linear(hidden_networks.policy_net), policy.action_net],
        "critic": [*_linear(hidden_networks.value_net), policy.value_net],
    }


def _linear(network: nn.Module) -> list[nn.Linear]:
    return [layer for layer in network.children() if isinstance(layer, nn.Linear)]


def has_finite_weights(model: Any) -> bool:
    return all(bool(torch.isfinite(parameter).all()) for parameter in model.policy.parameters())


class DoubleDQN(DQN):
    """DQN with the target of Double DQN (thesis Eq. 3.10, van Hasselt et al. 2015).

    The online network chooses the next action, and the target network values it.
    """

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """Take gradient steps as DQN does, by the next values of Double DQN."""
        target_network = self.q_net_target

        def next_values(observations: torch.Tensor) -> torch.Tensor:
            actions = self.q_net(observations).argmax(dim=1, keepdim=True)
            return target_network(observations).gather(1, actions)  # (N, 1): DQN takes the greatest in a row

        self.q_net_target = next_values  # type: ignore[assignment]
        try:
            super().train(gradient_steps, batch_size)
        finally:
            self.q_net_target = target_network


class WithoutBaseline(RolloutBuffer):
    """A rollout buffer whose advantages are the returns, without the critic's values (section 4.2)."""

    def compute_returns_and_advantage(self, last_values: torch.Tensor, dones: np.ndarray) -> None:
        """Use the returns, which are complete if lambda is 1, as advantages."""
        super().compute_returns_and_advantage(last_values, dones)
        self.advantages = self.returns.copy()


LEARNERS: dict[str, type[Learner]] = {
    "ppo": PPO, "a2c": A2C, "trpo": TRPO, "dqn": DQN, "double-dqn": DoubleDQN,
}  # fmt: skip


def field_arguments(run: Run) -> Iterator[tuple[str, str]]:
    """Yield each argument of a run's learner that is a field of the run, with the field's name."""
    learner_class = LEARNERS[run.algorithm]
    fields_by_argument: dict[str, str] = {}
    for field_name, declaration in FIELDS.items():
        if run.algorithm in declaration.read_by:
            fields_by_argument |= dict.fromkeys(declaration.arguments or (field_name,), field_name)
    if not issubclass(learner_class, DQN):  # its `n_steps` are those of n-step returns
        fields_by_argument["n_steps"] = "horizon"
    for argument in signature(learner_class).parameters:
        if argument in fields_by_argument:
            yield argument, fields_by_argument[argument]


# --- Training -------------------------------------------------------------------------------------


def prepare(model: Any, run: Run) -> None:
    """Let a learner log to memory alone, and train as in one call of `learn` for all steps of a run.

    Its `learn` is called for a part of them at a time. So schedules fall over all steps, and action noise
    is not reset in each call.
    """
    model.set_logger(Logger(folder=None, output_formats=[]))
    set_up_learning = model._setup_learn

    def set_up_once(*arguments: Any, **options: Any) -> Any:
        action_noise = getattr(model, "action_noise", None)
        if model._last_obs is None or action_noise is None:  # the first call
            return set_up_learning(*arguments, **options)
        model.action_noise = None  # it would be reset
        try:
            return set_up_learning(*arguments, **options)
        finally:
            model.action_noise = action_noise

    model._setup_learn = set_up_once
    update_progress = model._update_current_progress_remaining
    last_step = run.steps if run.seed_as == LIBRARY else run.trained_steps
    model._update_current_progress_remaining = lambda steps, _: update_progress(steps, last_step)


def learn(model: Any, steps: int, callback: BaseCallback) -> None:
    """Let a learner go on for so many agent steps, and train on them."""
    model.learn(steps, callback=callback, reset_num_timesteps=False, log_interval=None)


class PartwiseCallbacks(CallbackList):
    """Several callbacks of a training in several calls of `learn`: for them it starts and ends once."""

    _has_begun = False

    def _init_callback(self) -> None:
        if not self._has_begun:
            super()._init_callback()

    def _on_training_start(self) -> None:
        if not self._has_begun:
            super()._on_training_start()
        self._has_begun = True

    def _on_training_end(self) -> None:
        """Do nothing at the end of a call of `learn`."""

    def end(self) -> None:
        """Tell the callbacks that training has ended."""
        super()._on_training_end()


class Episodes(BaseCallback):
    """Collects the rows of the episodes that end.

    Attributes:
        counts: how many episodes have ended, by slot.
    """

    def __init__(self, run: Run, is_stopping: IsStopping = never) -> None:
        """End learning by `Stopped` as soon as `is_stopping`."""
        super().__init__()
        self._is_stopping = is_stopping
        self.counts: Counter[int] = Counter()
        self._has_monsters = not is_gymnasium_id(run.env)
        self._rows: list[Row] = []

    def _on_step(self) -> bool:
        check_stop(self._is_stopping)
        for slot, info in enumerate(self.locals["infos"]):
            episode = info.get("episode")
            if episode:
                row = episode_row(
                    slot=slot,
                    episode=self.counts[slot],
                    step=self.num_timesteps,
                    returned=float(episode["r"]),
                    length=int(episode["l"]),
                    ending="truncated" if info.get("TimeLimit.truncated") else "terminated",
                )
                if self._has_monsters:
                    row |= {column: info[column] for column in ("kills", "hp", "ending")}
                self._rows.append(row)
                self.counts[slot] += 1
        return True

    def take_rows(self) -> list[Row]:
        """Return and forget the episodes that have ended."""
        finished_rows = self._rows
        self._rows = []
        return finished_rows


LOGGED: dict[str, tuple[tuple[int, str], ...]] = {
    "policy_loss": (
        (1, "policy_gradient_loss"), (1, "policy_loss"), (1, "actor_loss"), (-1, "policy_objective"),
    ),
    "value_loss": ((1, "value_loss"), (1, "critic_loss"), (1, "loss")),
    "entropy": ((-1, "entropy_loss"),),
    "approx_kl": ((1, "approx_kl"), (1, "kl_divergence_loss")),
    "clip_fraction": ((1, "clip_fraction"),),
    "explained_variance": ((1, "explained_variance"),),
}  # fmt: skip
"""Metrics, and their names in the logs of learners, each with a sign; the first name that is found counts."""


def logged_losses(model: Any) -> dict[str, float]:
    """Return the metrics that a learner logged when it last trained."""
    logged_values = model.logger.name_to_value
    losses = {}
    for metric, logged_names in LOGGED.items():
        for sign, logged_name in logged_names:
            if f"train/{logged_name}" in logged_values:
                losses[metric] = sign * float(logged_values[f"train/{logged_name}"])
                break
    return losses


# --- Checkpoints ----------------------------------------------------------------------------------


_NUMBERS = ("_n_updates", "num_timesteps", "_n_calls", "exploration_rate")
"""Attributes of learners that are saved, of those that a learner has."""
_ARRAYS = ("_last_obs", "_last_episode_starts")
_REPLAYED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def take_checkpoint(model: Learner, step: int, records: Records) -> Checkpoint:
    env: Any = model.env
    generator: Any = np.random.get_state(legacy=False)
    arrays = {
        "random/torch": torch.get_rng_state().numpy().copy(),
        "random/numpy": generator["state"].pop("key"),
    }
    if model.device.type == CUDA:
        arrays["random/cuda"] = torch.cuda.get_rng_state().numpy().copy()
    for saved_name, tensor in model.policy.state_dict().items():
        arrays[f"policy/{saved_name}"] = copy_array(tensor)
    for index, entries in model.policy.optimizer.state_dict()["state"].items():
        for saved_name, entry in entries.items():
            if entry is not None:
                arrays[f"optimizer/{index}/{saved_name}"] = copy_array(entry)
    for saved_name, array in env.slots.saved_state().items():
        arrays[f"worlds/{saved_name}"] = array
    for attribute in _ARRAYS:
        arrays[attribute] = np.array(getattr(model, attribute))
    numbers: dict[str, Any] = {"numpy": generator}
    for attribute in _NUMBERS:
        if hasattr(model, attribute):
            numbers[attribute] = getattr(model, attribute)
    if isinstance(model, DQN):
        buffer: Any = model.replay_buffer
        for saved_name in _REPLAYED:
            arrays[f"replay/{saved_name}"] = getattr(buffer, saved_name)[: buffer.size()].copy()
        numbers |= {"position": buffer.pos, "full": buffer.full}
        numbers["random_actions"] = model.action_space.np_random.bit_generator.state
    return Checkpoint(step, arrays, numbers, records.copy())


def copy_array(tensor: Any) -> np.ndarray:
    """Copy a tensor of any device, or a number, into an array of the same shape."""
    return np.array(torch.as_tensor(tensor).detach().cpu().numpy(), order="C")


def restore_checkpoint(model: Learner, checkpoint: Checkpoint) -> None:
    """Restore a learner, and torch's and NumPy's global generators, from a checkpoint."""
    env: Any = model.env
    numbers, arrays = checkpoint.numbers, checkpoint.arrays
    optimizer = model.policy.optimizer
    # tensors are copies in torch's own memory, which its kernels need aligned
    optimizer_state: dict[int, dict[str, torch.Tensor]] = {}
    for array_path, array in checkpoint.part("optimizer/").items():
        parameter_index, _, saved_name = array_path.partition("/")
        optimizer_state.setdefault(int(parameter_index), {})[saved_name] = torch.tensor(array)
    optimizer.load_state_dict({**optimizer.state_dict(), "state": optimizer_state})
    policy = {saved_name: torch.tensor(array) for saved_name, array in checkpoint.part("policy/").items()}
    model.policy.load_state_dict(policy)
    env.slots.restore_state(checkpoint.part("worlds/"))
    torch.set_rng_state(torch.tensor(arrays["random/torch"]))
    if "random/cuda" in arrays:
        torch.cuda.set_rng_state(torch.tensor(arrays["random/cuda"]))
    generator = numbers["numpy"]
    np.random.set_state(generator | {"state": generator["state"] | {"key": arrays["random/numpy"]}})
    for attribute in _ARRAYS:
        setattr(model, attribute, arrays[attribute].copy())
    for attribute in _NUMBERS:
        if hasattr(model, attribute):
            setattr(model, attribute, numbers[attribute])
    if isinstance(model, DQN):
        buffer: Any = model.replay_buffer
        for saved_name in _REPLAYED:
            replayed = arrays[f"replay/{saved_name}"]
            getattr(buffer, saved_name)[: len(replayed)] = replayed
        buffer.pos, buffer.full = numbers["position"], numbers["full"]
        model.action_space.np_random.bit_generator.state = numbers["random_actions"]
