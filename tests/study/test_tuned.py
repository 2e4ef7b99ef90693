"""Shipped studies of what was tuned: each has what its search varies, and no more; beside it, untuned."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from pneuma.config import Run, make_run
from pneuma.search.space import Choices, Range
from pneuma.search.spec import load_search
from pneuma.study.definition import join_settings
from pneuma.study.spec import load_study

OPTIMIZERS = {
    "adam": "non-stationary", "l2": "l2", "upgd": "upgd", "sgd": "sgd", "momentum": "momentum",
    "rmsprop": "rmsprop",
}  # fmt: skip
"""What each is called in the study `optimizer`, where none is tuned."""


def run_of(study: str, condition: str) -> Run:
    return make_run(load_study(study).settings(condition))


def changes(run: Run, other: Run) -> set[str]:
    """Return the settings in which two runs differ."""
    own, others = asdict(run), asdict(other)
    return {key for key in own if own[key] != others[key]}


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_a_tuned_optimizer_has_what_its_search_varies_from_the_space_it_was_sought_in(name: str) -> None:
    tuned = run_of("tuned-optimizers", f"{name}-tuned")
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


@pytest.mark.parametrize(("name", "untuned"), OPTIMIZERS.items())
def test_beside_it_stands_what_the_study_of_optimizers_has(name: str, untuned: str) -> None:
    """So that they are the same runs, and trained once."""
    assert run_of("tuned-optimizers", name) == run_of("optimizer", untuned)
