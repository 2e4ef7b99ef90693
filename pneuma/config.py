"""Run configuration: the typed values that all layers share, and their allowed names.

A `Run` is one training, complete and frozen: the environment's fields, the learner's, a budget and a seed.
Studies resolve to runs, engines train them, the store is keyed by them. The environment's part is in
`env/fields.py`, that of algorithms and optimizers in `algorithms.py`.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, NoReturn

from annotated_types import Interval, Len

from pneuma.algorithms import (
    ALGORITHMS,
    OPTIMIZERS,
    VALUE_BASED,
    default_fields,
    find_algorithm,
    has_rollouts,
)
from pneuma.env.fields import ENVIRONMENTS, MODULE, EnvConfig, read_fields, resolve_world, with_environment
from pneuma.errors import UserError
from pneuma.field_types import (
    GYMNASIUM,
    OPEN_LEARNER,
    OPTIMIZER,
    OneOf,
    Reads,
    Share,
    declare,
    field_declarations,
    matching,
)
from pneuma.schema import normalize

RULES_VERSION = 3
"""Raised by hand when the same seed and actions give a different world; part of every run id."""

ENGINE_VERSIONS = {"batched": 4, "sb3": 3}
"""Raised by hand when an engine trains the same run to different numbers; part of every run id."""

ENGINES = tuple(ENGINE_VERSIONS)
"""The default comes first."""

CPU, CUDA = "cpu", "cuda"
"""What the engine `sb3` computes networks on, by PyTorch's names. The other engine knows the CPU alone."""

ACTIVATIONS = {"tanh": "Tanh", "relu": "ReLU", "leaky-relu": "LeakyReLU"}
"""Activation functions of hidden layers, and torch's classes of them; torch's slope of LeakyReLU is 0.01."""
STREAMS, LIBRARY = "streams", "library"
"""What a run's seed gives: see `Run.seed_as`."""
Schedule = Literal["constant", "linear"]


# --- The configuration ---------------------------------------------------------------------------


def _read_layers(layers: Any) -> tuple[int, ...]:
    widths = (layers,) if type(layers) is int else tuple(layers)
    if not 1 <= len(widths) <= 8:
        raise ValueError
    for width in widths:
        if type(width) is not int or not 1 <= width <= 65536:
            raise ValueError
    return widths


Layers = Annotated[
    tuple[int, ...], Reads(_read_layers, "1 to 65536 neurons, or a list of them, for 1 to 8 layers")
]
Fraction = Annotated[float, Interval(ge=0, le=0.999999)]
"""Below 1 by more than the rounding of float32."""
Steps = Annotated[int, Interval(ge=1, le=10**12)]


def _read_limit(limit: object) -> float | None:
    """Read the limit of a norm; "none" means no limit."""
    if limit is None or limit == "none":
        return None
    if isinstance(limit, bool) or not isinstance(limit, int | float) or not 0 < limit <= 1e9:
        raise ValueError
    return float(limit)


_FOREIGN = r"(?!(?i:pneuma))([\w.-]+/)?[\w.-]+-v\d+"
"""The form of an id of other environments that are registered with Gymnasium."""


def is_gymnasium_id(env_id: object) -> bool:
    """Return whether a name is the id of a Gymnasium environment other than Pneuma's own."""
    return isinstance(env_id, str) and re.fullmatch(_FOREIGN, env_id) is not None


def _read_arguments(arguments: Any) -> str:
    """Read a table of keyword arguments as JSON; equal tables give equal text."""
    argument_table = json.loads(arguments or "{}") if isinstance(arguments, str) else arguments
    if not isinstance(argument_table, Mapping):
        raise ValueError
    if not argument_table:
        return ""
    return json.dumps(normalize(argument_table, floats_to_integers=False), sort_keys=True, allow_nan=False)


def _read_wrappers(wrappers: Any) -> tuple[str, ...]:
    """Read classes, of `gymnasium.wrappers` where no module is named, with their arguments as JSON."""
    if wrappers == "":
        return ()
    if isinstance(wrappers, str):
        wrappers = [wrappers] if "{" in wrappers else wrappers.split(",")
    if isinstance(wrappers, Mapping):
        wrappers = [wrappers]
    return tuple(_read_wrapper(wrapper) for wrapper in wrappers)


def _read_wrapper(wrapper: Any) -> str:
    arguments: Any
    if isinstance(wrapper, Mapping):
        arguments = dict(wrapper)
        class_name = arguments.pop("name", "")
    else:
        class_name, brace, arguments_text = wrapper.partition("{")
        arguments = brace + arguments_text
    if class_name and ":" not in class_name:
        class_name = f"gymnasium.wrappers:{class_name}"
    if not re.fullmatch(rf"({MODULE}):\w+", class_name):
        raise ValueError
    return class_name + _read_arguments(arguments)


_ENV = matching(
    "|".join((*ENVIRONMENTS, _FOREIGN)),
    f"one of {', '.join(ENVIRONMENTS)}, or the id of a Gymnasium environment with its version, as "
    'CartPole-v1; for module:ID write env_module = "module" and env = "ID"',
    ENVIRONMENTS,
)
_ALGORITHM = matching(
    rf"{'|'.join(ALGORITHMS)}|({MODULE}):\w+",
    f"one of {', '.join(ALGORITHMS)}, or module:Class of a learner of Stable-Baselines3's kind",
    tuple(ALGORITHMS),
)
_ACTOR_CRITIC = "ppo, a2c, trpo"
_DQN = "dqn, double-dqn"
_WITH_FIELDS = f"{_ACTOR_CRITIC}, {_DQN}"


@dataclass(frozen=True, kw_only=True)
class Run(EnvConfig):
    """One training: environment, learner, budget and seed. Equal runs end with equal bits."""

    env: Annotated[str, _ENV] = declare(ENVIRONMENTS[0], paces=True)
    env_module: Annotated[str, matching(rf"|{MODULE}", "a module that registers environments")] = declare(
        "", read_by=GYMNASIUM
    )
    """Imported before the environment is made: a module, or the path of its file."""
    env_kwargs: Annotated[str, Reads(_read_arguments, "a table of keyword arguments")] = declare(
        "", read_by=GYMNASIUM
    )
    wrappers: Annotated[
        tuple[str, ...], Reads(_read_wrappers, "module:Class, or a list of such, or of { name, arguments }")
    ] = declare((), read_by=GYMNASIUM)
    """Wrapper classes, the innermost first; followed by their arguments as JSON, if they have some."""
    normalize_observations: bool = declare(False, read_by=GYMNASIUM)
    """By their running mean and variance in training, as Stable-Baselines3's VecNormalize does."""
    normalize_rewards: bool = declare(False, read_by=GYMNASIUM)
    """By the running deviation of the discounted return, for the learner only, as VecNormalize does."""
    engine: Annotated[str, OneOf(ENGINES)] = declare(ENGINES[0], paces=True)
    device: Annotated[str, OneOf((CPU, CUDA))] = declare(CPU, paces=True)
    """Where the networks of the engine `sb3` are. Environments and evaluations are on the CPU."""
    algorithm: Annotated[str, _ALGORITHM] = declare("ppo", paces=True)
    policy: Annotated[str, matching(r"|\w+Policy", "a policy of the learner, as CnnPolicy")] = declare(
        "", read_by=OPEN_LEARNER
    )
    """Stable-Baselines3's name of the learner's policy, if it is not MlpPolicy."""
    algorithm_kwargs: Annotated[str, Reads(_read_arguments, "a table of arguments of the learner")] = declare(
        "", read_by=OPEN_LEARNER
    )
    seed: Annotated[int, Interval(ge=0, le=2**32 - 1)] = 0
    seed_as: Annotated[str, OneOf((STREAMS, LIBRARY))] = STREAMS
    """Whether the seed keys streams of random numbers, or is the argument of Stable-Baselines3's learner."""
    steps: Steps = declare(50_000, arguments="n_timesteps", paces=True)
    """Budget in agent steps, summed over slots. The last update may end after it: see `trained_steps`."""
    slots: Annotated[int, Interval(ge=1, le=1024)] = declare(1, arguments="n_envs", paces=True)
    """Worlds that collect a rollout in parallel."""
    learners: Literal["shared", "independent"] = declare("shared", read_by="ppo")
    """Whether all players of a world learn one policy, or each its own (independent PPO)."""

    actor: Layers = declare((128,), read_by=_WITH_FIELDS, paces=True)
    critic: Layers = declare((256,), read_by=_ACTOR_CRITIC, paces=True)
    activation: Annotated[str, OneOf(tuple(ACTIVATIONS))] = declare("tanh", read_by=_WITH_FIELDS)
    first_layer_scale: Annotated[float, Interval(gt=0, le=1e6)] = declare(1.0, read_by="ppo")
    """Factor on the initial weights of both first layers."""

    gamma: Share = declare(0.99, read_by=_WITH_FIELDS)
    gae_lambda: Share = declare(0.95, read_by=_ACTOR_CRITIC)
    learning_rate: Annotated[float, Interval(gt=0, le=100)] = declare(3e-4, read_by=_WITH_FIELDS)
    learning_rate_schedule: Schedule = declare("constant", read_by=_WITH_FIELDS)
    """With "linear" it falls from its value to 0 over all updates, as Stable-Baselines3 counts progress."""
    clip_range: Annotated[float, Interval(gt=0, le=100)] = declare(0.1, read_by="ppo")
    clip_range_schedule: Schedule = declare("constant", read_by="ppo")
    horizon: Annotated[int, Interval(ge=2, le=10**6)] = declare(256, arguments="n_steps", paces=True)
    """Steps per slot in a rollout; of learners without rollouts, between two records."""
    minibatch: Annotated[int, Interval(ge=2, le=10**6)] = declare(
        64, read_by=f"ppo, trpo, {_DQN}", arguments="batch_size", paces=True
    )
    epochs: Annotated[int, Interval(ge=1, le=1000)] = declare(
        10, read_by="ppo, trpo", arguments="n_epochs, n_critic_updates", paces=True
    )
    value_coefficient: Annotated[float, Interval(ge=0, le=1e6)] = declare(
        0.5, read_by="ppo, a2c", arguments="vf_coef"
    )
    entropy_coefficient: Annotated[float, Interval(ge=0, le=1e6)] = declare(
        0.01, read_by="ppo, a2c", arguments="ent_coef"
    )
    gradient_limit: Annotated[float | None, Reads(_read_limit, 'a number above 0, or "none"')] = declare(
        0.5, read_by=f"ppo, a2c, {_DQN}", arguments="max_grad_norm"
    )
    """Greatest L2 norm of the gradient; None for no limit (thesis section 6.2)."""
    clip: Literal["joint", "separate"] = declare("joint", read_by="ppo, a2c")
    """One norm over actor and critic together, as in Stable-Baselines3, or one for each."""
    value_baseline: bool = declare(True, read_by=_ACTOR_CRITIC)
    """Whether the critic's values are subtracted from returns to make advantages (thesis section 4.2)."""
    normalize_advantage: bool = declare(True, read_by="ppo")
    """Whether each minibatch's advantages are given mean 0 and standard deviation 1."""

    target_kl: Annotated[float, Interval(gt=0, le=100)] | None = declare(None, read_by="trpo")
    """TRPO's trust region: the greatest mean KL divergence of one update (thesis Eq. 4.12)."""
    conjugate_steps: Annotated[int, Interval(ge=1, le=1000)] | None = declare(
        None, read_by="trpo", arguments="cg_max_steps"
    )
    line_search_steps: Annotated[int, Interval(ge=1, le=1000)] | None = declare(
        None, read_by="trpo", arguments="line_search_max_iter"
    )

    exploration: Share | None = declare(None, read_by=_DQN, arguments="exploration_final_eps")
    """Probability of a random action, for learners that choose actions by value (thesis Eq. 4.4)."""
    exploration_fraction: Share | None = declare(None, read_by=_DQN)
    """Share of the budget over which this probability falls from 1 to `exploration`."""
    buffer_size: Annotated[int, Interval(ge=1, le=10**8)] | None = declare(None, read_by=_DQN, paces=True)
    """Transitions that DQN keeps for replay, over all slots."""
    learning_starts: Annotated[int, Interval(ge=0, le=10**9)] | None = declare(None, read_by=_DQN)
    """Agent steps of random actions before the first gradient."""
    train_every: Annotated[int, Interval(ge=1, le=10**6)] | None = declare(
        None, read_by=_DQN, arguments="train_freq"
    )
    """Steps per slot between gradients."""
    gradient_steps: Annotated[int, Interval(ge=1, le=10_000)] | None = declare(None, read_by=_DQN)
    target_every: Annotated[int, Interval(ge=1, le=10**12)] | None = declare(
        None, read_by=_DQN, arguments="target_update_interval"
    )
    """Agent steps between copies to the target network; 1 is as good as no target network."""

    optimizer: Annotated[str, OneOf(tuple(OPTIMIZERS))] = declare("adam", read_by=_WITH_FIELDS, paces=True)
    betas: Annotated[tuple[Fraction, ...], Len(2, 2)] | None = declare(None, read_by=OPTIMIZER)
    epsilon: Annotated[float, Interval(gt=0, le=1)] | None = declare(None, read_by=OPTIMIZER, arguments="eps")
    momentum: Fraction | None = declare(None, read_by=OPTIMIZER)
    dampening: Share | None = declare(None, read_by=OPTIMIZER)
    """Equal to `momentum`, it weighs a new gradient by 1 - beta as the thesis does (torch: but the first)."""
    smoothing: Fraction | None = declare(None, read_by=OPTIMIZER, arguments="alpha")
    """Decay of RMSProp's mean square."""
    utility_decay: Fraction | None = declare(None, read_by=OPTIMIZER)
    """Decay of UPGD's mean utility of a weight."""
    noise: Annotated[float, Interval(ge=0, le=1000)] | None = declare(None, read_by=OPTIMIZER)
    """Standard deviation of the noise that UPGD adds to Adam's step, before protection."""
    weight_decay: Share = declare(0.0, read_by=_WITH_FIELDS)
    """L2 regularisation: added to the gradient, as torch defines it; UPGD shrinks weights by it instead."""

    evaluation_episodes: Annotated[int, Interval(ge=1, le=10_000)] = declare(50, paces=True)
    held_out_levels: Annotated[int, Interval(ge=0, le=10_000)] = 0
    """Number of random islands, never trained on, for evaluation; 0 evaluates on the training level."""

    @property
    def steps_per_update(self) -> int:
        """Agent steps, over all slots and players, in one update."""
        return self.horizon * self.slots * self.players

    @property
    def policies(self) -> int:
        """Number of policies that learn."""
        return self.players if self.learners == "independent" else 1

    @property
    def updates(self) -> int:
        """Number of updates: as many as the budget begins."""
        return -(-self.steps // self.steps_per_update)

    @property
    def trained_steps(self) -> int:
        """Agent steps at the end of the last update: the budget, or less than an update more."""
        return self.updates * self.steps_per_update


FIELDS = field_declarations(Run)
"""The declaration of each field of a run."""
WORLD_FIELDS = tuple(field_declarations(EnvConfig))
GYMNASIUM_FIELDS = tuple(
    field_name for field_name, declaration in FIELDS.items() if declaration.read_by == (GYMNASIUM,)
)
"""Fields of environments other than Pneuma's, in place of those of `EnvConfig`."""
ANNEALED = tuple(field_name for field_name in FIELDS if f"{field_name}_schedule" in FIELDS)
"""Fields that may fall over a run, each by its own schedule, as rl-baselines3-zoo's settings need."""


def make_run(settings: Mapping[str, object]) -> Run:
    """Resolve fields to a complete run: checked, with all defaults filled in.

    Missing fields come from the environment's preset, and from the defaults of the algorithm and the
    optimizer. What these do not read is at the default of `Run`, so that two ways to write the same training
    give the same run.
    """
    env_id = str(settings.get("env", ENVIRONMENTS[0]))
    run_defaults = vars(Run())
    field_values: dict[str, Any] = {}
    for field_name, field_value in read_fields(Run, with_environment(env_id, settings)).items():
        if field_value is not None or run_defaults[field_name] is not None:
            field_values[field_name] = field_value
    if not is_gymnasium_id(env_id):
        field_values = resolve_world(field_values)

    given = Run(**field_values)
    field_values |= _rollout_steps(given, field_values)
    defaults = default_fields(given.algorithm, field_values.get("optimizer", ""))
    all_values = {**defaults, **field_values}
    readable = _readable_fields(Run(**all_values))
    run = Run(**{field_name: value for field_name, value in all_values.items() if field_name in readable})
    idle = readable - effective_fields(run)
    run = replace(
        run, **{field_name: defaults.get(field_name, run_defaults[field_name]) for field_name in idle}
    )
    run = replace(run, engine=_engine(run, field_values.get("engine", "")))
    if field_values.get("learners") == "independent" and run.players > 1 and run.engine != ENGINES[0]:
        _refuse("learners = independent", f"{run.engine} trains one policy for all players")
    _check_learner(run)
    return run


def _rollout_steps(run: Run, settings: Mapping[str, Any]) -> dict[str, int]:
    """Return the horizon of a learner whose arguments have the length of its rollouts, `n_steps`."""
    n_steps = json.loads(run.algorithm_kwargs or "{}").get("n_steps")
    if n_steps is None or not has_rollouts(run.algorithm):
        return {}
    horizon: int = read_fields(Run, {"horizon": n_steps})["horizon"]
    if settings.get("horizon", horizon) != horizon:
        problem = f"algorithm_kwargs has n_steps = {n_steps}: leave one out"
        _refuse(f"horizon = {settings['horizon']}", problem)
    return {"horizon": horizon}


def effective_fields(run: Run) -> set[str]:
    """Return the names of the fields that affect a run, given its other fields."""
    idle_fields = {
        "dampening": not run.momentum,
        "clip": run.gradient_limit is None,
        "learners": run.players == 1,
        "activation": "activation_fn" in run.algorithm_kwargs,
        "policy": not run.policy,
        "algorithm_kwargs": not run.algorithm_kwargs,
        "device": run.engine == ENGINES[0] and run.device == CPU,
        "seed_as": run.engine == ENGINES[0] and run.seed_as == STREAMS,
    }
    return _readable_fields(run) - {field_name for field_name, is_idle in idle_fields.items() if is_idle}


def _readable_fields(run: Run) -> set[str]:
    """Return the fields that a run's environment, algorithm and optimizer have."""
    is_gymnasium, resumable = is_gymnasium_id(run.env), is_resumable(run)
    readers = {OPEN_LEARNER}
    field_names: set[str] = set()
    if is_gymnasium:
        readers.add(GYMNASIUM)
    if run.algorithm == "ppo" or resumable:  # other learners get all else by `algorithm_kwargs`
        readers.add(run.algorithm)
        field_names |= OPTIMIZERS[run.optimizer].defaults.keys()
    for field_name, declaration in FIELDS.items():
        if field_name in WORLD_FIELDS and is_gymnasium:
            continue
        if not declaration.read_by or not readers.isdisjoint(declaration.read_by):
            field_names.add(field_name)
    if run.algorithm in VALUE_BASED and resumable:  # replayed observations had another mean and variance
        field_names -= {"normalize_observations", "normalize_rewards"}
    return field_names


def is_resumable(run: Run) -> bool:
    """Return whether a stopped run goes on with the same bits.

    Stable-Baselines3 trains all others as a user's own script would.
    """
    return not (find_algorithm(run.algorithm).learner or run.policy or run.algorithm_kwargs)


def batched_limitation(run: Run) -> str:
    """Return what the compiled engine cannot do for a run; empty if it can train it."""
    if ENGINES[0] not in find_algorithm(run.algorithm).engines:
        return f"the algorithm {run.algorithm}"
    if run.policy or run.algorithm_kwargs:
        return "a run with policy or algorithm_kwargs"
    if run.device != CPU:
        return f"a run with device = {run.device}"
    if run.seed_as != STREAMS:
        return f"a run with seed_as = {run.seed_as}"
    if not run.value_baseline:
        return "advantages without a baseline"
    return ""


def _engine(run: Run, engine: str) -> str:
    """Return the engine that a study sets, or the first one that can train a run."""
    limitation = batched_limitation(run)
    engines = find_algorithm(run.algorithm).engines
    able_engines = [engine_name for engine_name in engines if engine_name != ENGINES[0] or not limitation]
    if not engine:
        return able_engines[0]
    if engine not in able_engines:
        _refuse(f'engine = "{engine}"', f"it cannot train {limitation}; {' and '.join(able_engines)} can")
    return engine


def _refuse(setting: str, reason: str) -> NoReturn:
    raise UserError(f"{setting} is not allowed: {reason}")


def _check_learner(run: Run) -> None:
    if not is_resumable(run) and not is_gymnasium_id(run.env):
        setting = f"algorithm = {run.algorithm}"
        if not find_algorithm(run.algorithm).learner:
            setting = "policy" if run.policy else "algorithm_kwargs"
        raise UserError(f"{setting} is not allowed in {run.env}: only Gymnasium's other environments have it")
    if "optimizer" in effective_fields(run) and run.engine not in OPTIMIZERS[run.optimizer].engines:
        able_engines = " or ".join(OPTIMIZERS[run.optimizer].engines)
        _refuse(f"optimizer = {run.optimizer}", f"the engine {run.engine} lacks it; {able_engines} has it")
    if run.train_every and run.horizon % run.train_every:
        _refuse(f"train_every = {run.train_every}", f"horizon = {run.horizon} is no multiple of it")
    if run.held_out_levels and not run.level.startswith("random:train:"):
        _refuse(f"held_out_levels = {run.held_out_levels}", f"{run.level} is not of random:train:")


def env_config(run: Run) -> EnvConfig:
    return EnvConfig(**{field_name: getattr(run, field_name) for field_name in WORLD_FIELDS})


def evaluation_config(run: Run) -> EnvConfig:
    world_config = env_config(run)
    if not run.held_out_levels:
        return world_config
    return replace(world_config, level="random:test:0", random_levels=run.held_out_levels)


def as_fields(config: EnvConfig) -> dict[str, Any]:
    """Return a configuration as a flat dictionary for JSON, which `make_run` reads."""
    field_values = dict(vars(config))
    for field_name, field_value in field_values.items():
        if isinstance(field_value, tuple):
            field_values[field_name] = list(field_value)
    return field_values


def stream_seed(key: int | str, purpose: str, slot: int = 0) -> int:
    """Return the 64-bit seed of a random stream; of a run, the key is its seed.

    Streams are keyed by a hash, not by adding numbers, so that no two purposes, slots or seeds share one.
    Runs of different conditions with the same seed do share them. They start with the same worlds and, if the
    networks have the same shape, the same weights.
    """
    digest = hashlib.sha256(f"{key}/{purpose}/{slot}".encode()).digest()
    return int.from_bytes(digest[:8], "little")


def slot_seeds(run: Run) -> list[int]:
    """Return the seed of each slot's worlds in training."""
    if run.seed_as == LIBRARY:  # which gives its first environment its own seed, and the next ones the next
        return [run.seed + slot for slot in range(run.slots)]
    return [stream_seed(run.seed, "world", slot) for slot in range(run.slots)]
