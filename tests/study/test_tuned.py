"""Shipped studies of what was tuned: each has what its search varies, and no more; beside it, untuned."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import pytest

from pneuma.config import Run, make_run
from pneuma.search.promote import winner
from pneuma.search.record import read_record
from pneuma.search.recorded import recorded_search
from pneuma.search.space import Choices, Range
from pneuma.search.spec import load_search
from pneuma.study.definition import join_settings
from pneuma.study.spec import load_study
from pneuma.study.store import Store

PUBLISHED = Path(__file__).parents[2] / "results"

OPTIMIZERS = {
    "adam": "non-stationary", "l2": "l2", "upgd": "upgd", "sgd": "sgd", "momentum": "momentum",
    "rmsprop": "rmsprop",
}  # fmt: skip
"""What each is called in the study `optimizer`, where none is tuned."""
ALGORITHMS = ("ppo", "trpo", "a2c", "dqn", "double-dqn")

UNTUNED = {
    **{("tuned-optimizers", name): ("optimizer", untuned) for name, untuned in OPTIMIZERS.items()},
    **{("tuned-algorithms", name): ("algorithms", name) for name in ALGORITHMS},
}
"""The studies and conditions in which each stands untuned, by those in which it is tuned."""


def run_of(study: str, condition: str) -> Run:
    return make_run(load_study(study).settings(condition))


def changes(run: Run, other: Run) -> set[str]:
    """Return the settings in which two runs differ."""
    own, others = asdict(run), asdict(other)
    return {key for key in own if own[key] != others[key]}


@pytest.mark.parametrize(("study", "name"), UNTUNED)
def test_what_is_tuned_has_what_its_search_varies_from_the_space_it_was_sought_in(
    study: str, name: str
) -> None:
    tuned = run_of(study, f"{name}-tuned")
    search = load_search(f"tune-{name}")
    fixed = make_run(join_settings(search.space.base, search.space.fixed))
    searched = {parameter.name for parameter in search.space.parameters}
    assert changes(tuned, fixed) <= searched | {"dampening"}  # without momentum there is none
    assert tuned.dampening == search.space.fixed.get("dampening", fixed.dampening)
    for parameter in search.space.parameters:
        value = getattr(tuned, parameter.name)
        if isinstance(parameter.domain, Range):
            assert parameter.domain.low <= value <= parameter.domain.high
        else:
            assert isinstance(parameter.domain, Choices)
            chosen = [dict(own)[parameter.name] for own in parameter.domain.settings_of.values()]
            assert value in chosen


@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_tuned_algorithm_is_the_best_trial_of_its_published_search(name: str) -> None:
    record = read_record(Store(PUBLISHED), f"tune-{name}")
    search = recorded_search(load_search(f"tune-{name}"), record)
    budget = search.presets["paper"]
    assert (len(record["trials"]), tuple(record["seeds"]), record["steps"]) == (
        budget.trials, budget.seeds, budget.steps,
    )  # fmt: skip
    found = search.space.settings(winner(record, None)["params"])
    assert run_of("tuned-algorithms", f"{name}-tuned") == make_run(join_settings(search.space.base, found))


@pytest.mark.parametrize(("tuned", "untuned"), UNTUNED.items())
def test_beside_it_stands_what_it_is_untuned(tuned: tuple[str, str], untuned: tuple[str, str]) -> None:
    """So that they are the same runs, and trained once."""
    assert run_of(*tuned) == run_of(*untuned)
