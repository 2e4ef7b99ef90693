"""What a search is refused for before anything is trained."""

from __future__ import annotations

import pytest

from pneuma.errors import UserError
from pneuma.search import driver
from pneuma.search.driver import check_outcomes

from .conftest import MakeTask

CMA_ES = '[sampler]\nname = "cma-es"\n'
SECOND = '[objectives.deep]\noutcome = "final-return"'


def test_cma_es_wants_one_objective_and_its_package(
    make_task: MakeTask, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_outcomes(make_task(more=CMA_ES))
    with pytest.raises(UserError, match="sampler cma-es: goes with one objective alone"):
        check_outcomes(make_task(more=CMA_ES, second=SECOND))
    monkeypatch.setattr(driver, "find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"pip install '.\[cmaes\]'"):
        check_outcomes(make_task(more=CMA_ES))
    check_outcomes(make_task())
