"""What Optuna does in a search: suggesting trials, stopping them early, and finding the best.

The Optuna study that suggests is in memory. Before each ask, the sampler is made again with a seed of the
trial, so that a suggestion depends only on the trials before it, and not on the number of workers or on how
often the search was stopped (Akiba et al. 2019 describe ask and tell). What a log in a results folder says is
never given to a sampler but for parameters and values: CMA-ES would unpickle more.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import optuna
from optuna import pruners, samplers
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.exceptions import ExperimentalWarning
from optuna.study import StudyDirection
from optuna.trial import TrialState, create_trial

from pneuma.config import stream_seed
from pneuma.errors import unknown_name
from pneuma.schema import shown, wrong
from pneuma.search.space import Parameter, Space

if TYPE_CHECKING:
    from pneuma.search.spec import Search
    from pneuma.search.trials import EndedTrial

optuna.logging.set_verbosity(optuna.logging.ERROR)

STATES = {"complete": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "failed": TrialState.FAIL}

# --- Samplers and pruners --------------------------------------------------------------------------


@dataclass(frozen=True)
class Kind:
    """A sampler or pruner of Optuna, with the package that Optuna needs for it.

    `arguments` may be set by a file; they have Optuna's names, and defaults of which None is Optuna's own.
    """

    make: Callable[..., Any]
    arguments: Mapping[str, Any]
    package: str = ""


class Grid(samplers.GridSampler):
    """Optuna's, which asks a study to stop when it is through; here the budget says when."""

    def after_trial(self, *_: Any) -> None:
        pass


SAMPLERS = {
    "tpe": Kind(
        samplers.TPESampler,
        {
            "n_startup_trials": 10, "n_ei_candidates": 24, "multivariate": True, "group": True,
            "constant_liar": True,
        },
    ),
    "gp": Kind(samplers.GPSampler, {"n_startup_trials": 10, "deterministic_objective": False}),
    "cmaes": Kind(
        samplers.CmaEsSampler,
        {
            "sigma0": None, "n_startup_trials": 1, "popsize": None, "consider_pruned_trials": False,
            "use_separable_cma": False, "with_margin": False, "lr_adapt": False,
        },
        package="cmaes",
    ),
    "nsga-ii": Kind(
        samplers.NSGAIISampler,
        {"population_size": 16, "mutation_prob": 0.1, "crossover_prob": 0.9, "swapping_prob": 0.5},
    ),
    "random": Kind(samplers.RandomSampler, {}),
    "grid": Kind(Grid, {}),
}  # fmt: skip
EVERY_FIVE = {"n_startup_trials": 5, "n_warmup_steps": 5, "interval_steps": 5, "n_min_trials": 1}
PRUNERS = {
    "": Kind(pruners.NopPruner, {}),
    "median": Kind(pruners.MedianPruner, EVERY_FIVE),
    "percentile": Kind(pruners.PercentilePruner, {"percentile": 25.0, **EVERY_FIVE}),
    "successive-halving": Kind(
        pruners.SuccessiveHalvingPruner,
        {"min_resource": 2, "reduction_factor": 3, "min_early_stopping_rate": 0, "bootstrap_count": 0},
    ),
    "hyperband": Kind(
        pruners.HyperbandPruner,
        {"min_resource": 2, "max_resource": 20, "reduction_factor": 3, "bootstrap_count": 0},
    ),
    "wilcoxon": Kind(pruners.WilcoxonPruner, {"p_threshold": 0.1, "n_startup_steps": 2}),
}
"""By name. The steps of a pruner are twentieths of a run's training; Wilcoxon's are seeds."""

LEAST = {
    "min_resource": 1, "max_resource": 1, "reduction_factor": 2, "n_ei_candidates": 1, "popsize": 2,
    "sigma0": 1e-6, "population_size": 2,
}  # fmt: skip
"""Of arguments that Optuna checks only when it uses them."""


def read_choice(kinds: Mapping[str, Kind], value: Any) -> Any:
    """Read [sampler] or [pruner]: `name`, and arguments by Optuna's names, into name and all arguments."""
    if not isinstance(value, Mapping):
        return value
    name = value.get("name", "")
    if not isinstance(name, str) or name not in kinds:
        raise wrong(str(unknown_name("name", str(name), [*filter(None, kinds)])), "name")
    given = {key: each for key, each in value.items() if key != "name"}
    kind = kinds[name]
    for key, each in given.items():
        if key not in kind.arguments:
            raise wrong(str(unknown_name(f"argument of {name}", key, kind.arguments)), key)
        usual = kind.arguments[key]
        number = isinstance(each, int if isinstance(usual, int) or key == "popsize" else int | float)
        if isinstance(each, bool) != isinstance(usual, bool) or not number:
            allowed = "true or false" if isinstance(usual, bool) else "a number, whole if the default is"
            raise wrong(f"{key} = {shown(each)} is not allowed: {allowed}", key)
        if each < (least := LEAST.get(key, each)):
            raise wrong(f"{key} = {shown(each)} is not allowed: at least {least}", key)
    arguments = {**kind.arguments, **given}
    if arguments.get("max_resource", math.inf) < arguments.get("min_resource", 0):
        raise wrong("max_resource is less than min_resource", "name")
    if kind.package and find_spec(kind.package) is None:
        raise wrong(f"{name} needs a package that is missing: pip install {kind.package}", "name")
    if name != "grid":
        try:
            _make(kind, arguments)
        except (ValueError, TypeError, AssertionError) as error:
            raise wrong(f"{name}: {error}", next(iter(given), "name")) from None
    return {"name": name, "arguments": arguments}


def _make(kind: Kind, arguments: Mapping[str, Any], **more: Any) -> Any:
    given = {key: value for key, value in arguments.items() if value is not None}
    with warnings.catch_warnings(action="ignore"):  # of arguments that are experimental, or go with Optuna 6
        return kind.make(**given, **more)


def make_sampler(search: Search, number: int) -> samplers.BaseSampler:
    """Return the sampler of a trial, with every argument that affects its suggestions set."""
    chosen = search.spec.sampler
    more: dict[str, Any] = {"seed": stream_seed(search.name, "sampler", number) % 2**32}
    if chosen.name == "grid":
        more = {
            "search_space": {each.name: each.extremes for each in search.space.parameters},
            "seed": stream_seed(search.name, "grid") % 2**32,  # one order for all trials
        }
    made: samplers.BaseSampler = _make(SAMPLERS[chosen.name], chosen.arguments, **more)
    return made


# --- Asking ---------------------------------------------------------------------------------------


def create_study(search: Search, objectives: int | None = None, storage: Any = None) -> optuna.Study:
    """Return a study without trials, in memory unless told, with the first so many objectives."""
    sought, pruner = search.objectives[:objectives], search.spec.pruner
    study = optuna.create_study(
        storage=storage,
        sampler=samplers.RandomSampler(seed=0),
        pruner=_make(PRUNERS[pruner.name], pruner.arguments),
        study_name=search.name,
        directions=[StudyDirection[objective.direction.upper()] for objective in sought],
    )
    with warnings.catch_warnings(action="ignore", category=ExperimentalWarning):
        study.set_metric_names([f"{objective.outcome}, {objective.over_seeds}" for objective in sought])
    return study


def ask(study: optuna.Study, search: Search, first_trials: Sequence[Mapping[str, Any]]) -> optuna.Trial:
    """Ask a study for the next trial and all of its parameters."""
    number = len(study.get_trials(deepcopy=False))
    if number < len(first_trials):
        study.enqueue_trial(dict(first_trials[number]))
    with warnings.catch_warnings(action="ignore", category=ExperimentalWarning):
        study.sampler = make_sampler(search, number)
        trial = study.ask()
        search.space.ask(lambda parameter: _suggest(trial, parameter))
    return trial


def _suggest(trial: optuna.Trial, parameter: Parameter) -> Any:
    if parameter.choices:
        return trial.suggest_categorical(parameter.name, [*parameter.choices])
    low, high = parameter.extremes
    suggest = trial.suggest_int if parameter.whole else trial.suggest_float
    return suggest(parameter.name, low, high, log=parameter.log)


# --- What has ended -------------------------------------------------------------------------------


def ended_study(trials: Iterable[EndedTrial], search: Search, objectives: int | None = None) -> optuna.Study:
    """Return a study in memory of trials that have ended, with the values of the first so many objectives.

    Raises ValueError for a parameter or value that is not in the search space.
    """
    study = create_study(search, objectives)
    study.add_trials(
        create_trial(
            state=STATES[trial.state],
            values=list(trial.values[:objectives]) if trial.state == "complete" else None,
            params=dict(trial.params),
            distributions=distributions(search.space, trial.params),
            intermediate_values=dict(trial.reports),
        )
        for trial in trials
    )
    return study


def distributions(space: Space, names: Iterable[str]) -> dict[str, BaseDistribution]:
    """Return Optuna's distributions of parameters; ValueError for one that is not in the space."""
    known = {parameter.name: parameter for parameter in space.parameters}
    if unknown := {*names} - {*known}:
        raise ValueError(f"{min(unknown)} is no parameter")
    return {name: _distribution(known[name]) for name in names}


def _distribution(parameter: Parameter) -> BaseDistribution:
    if parameter.choices:
        return CategoricalDistribution([*parameter.choices])
    low, high = parameter.extremes
    kind = IntDistribution if parameter.whole else FloatDistribution
    return kind(low, high, log=parameter.log)
