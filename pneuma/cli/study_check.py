"""`pneuma study check`: published runs, trained again, against what was published."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

from pneuma.cli import options as opt
from pneuma.cli.output import Result, answer_result, say


def check(
    name: opt.Study,
    selection: opt.RunFilter,
    runs: Annotated[Any, opt.count("How many runs are trained again, the shortest first.")] = 2,
) -> Result:
    """Train published runs again, and compare them with the published ones to the last bit.

    Example: pneuma study check activation@paper --runs 2

    The runs train in a temporary folder, which is removed afterwards. They are of the preset paper if none is
    named. The exit code is 1 if anything differs.
    """
    from pneuma import api

    answer = api.check_runs(selection.query(name), selection.store, runs, say=say)
    return replace(answer_result(answer), code=int(not answer.is_same))
