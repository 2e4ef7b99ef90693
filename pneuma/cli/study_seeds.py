"""`pneuma study plan --detect`: how many seeds a comparison needs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pneuma.cli.output import Result, Table, frame_table
from pneuma.cli.study_notes import with_unit
from pneuma.errors import UserError

if TYPE_CHECKING:
    import pandas as pd

    from pneuma.analysis.study_data import StudyData


def seeds_result(data: StudyData | None, detect: float, outcome: str | None, sd: float | None) -> Result:
    """Return how many seeds a condition needs, by the runs there are or by a standard deviation."""
    import pandas as pd

    from pneuma.analysis.environments import by_environment
    from pneuma.analysis.outcomes import primary
    from pneuma.analysis.power import POWER, seeds_for_means

    if detect <= 0:
        raise UserError(f"--detect {detect:g}: must be a difference above 0")
    if sd is not None:
        if sd <= 0:
            raise UserError(f"--sd {sd:g}: must be above 0")
        table = pd.DataFrame([{"SD": f"{sd:g}", "seeds": _told(seeds_for_means(detect, sd, sd))}])
        name, title = outcome or "any outcome", f"Seeds to detect {detect:g}"
    else:
        assert data is not None
        name = outcome or primary(data)
        parts = by_environment(data) if data.study.factors else {"": data}
        rows = {env: _by_runs(part, name, detect) for env, part in parts.items()}
        table = (
            pd.concat(rows, names=["environment"]).reset_index(level=0)
            if len(rows) > 1
            else rows.popitem()[1]
        )
        title = f"{data.full_title}: seeds to detect {detect:g}"
    legend = (
        f"Seeds of each condition with which the 95 % interval of the difference leaves out 0 in {POWER:.0%}"
    )
    shown: list[str | Table] = ["", frame_table(table), "", f"{legend} of studies, if it is that large."]
    heading = f"{title} of {with_unit(name) if outcome or data else name}"
    return Result({"outcome": name, "detect": detect, "seeds": table}, shown, heading, (), table, table)


def _by_runs(data: StudyData, outcome: str, detect: float) -> pd.DataFrame:
    """Return the seeds that each condition needs beside the baseline."""
    import numpy as np
    import pandas as pd

    from pneuma.analysis.outcomes import outcome_values
    from pneuma.analysis.power import seeds_for_means, seeds_for_shares

    values = {name: outcome_values(data, name, outcome) for name in data.conditions}
    known = {name: each[np.isfinite(each)] for name, each in values.items()}
    base = data.study.baseline if data.study.baseline in known else data.conditions[0]
    rows = []
    for name in data.conditions:
        if name == base:
            continue
        pair = known[base], known[name]
        if min(map(len, pair)) < 2:
            seeds = "needs 2 runs of each"
        elif all(np.isin(each, (0, 1)).all() for each in pair):  # whether a run has something
            share = float(pair[0].mean())
            other = share + detect if share + detect <= 1 else share - detect
            seeds = _told(seeds_for_shares(share, other))
        elif not any(np.ptp(each) for each in pair):
            seeds = "runs are all equal"
        else:
            seeds = _told(seeds_for_means(detect, *(float(each.std(ddof=1)) for each in pair)))
        deviations = [f"{each.std(ddof=1):.3g}" if len(each) > 1 else "–" for each in pair]
        rows.append((base, name, *deviations, f"{len(pair[0])} and {len(pair[1])}", seeds))
    if not rows:
        raise UserError(f"study {data.study.name} has one condition: there is nothing to compare it with")
    return pd.DataFrame(rows, columns=["", "against", "SD", "SD of it", "runs", "seeds"])


def _told(seeds: int | None) -> str:
    return "more than can be trained" if seeds is None else f"{seeds:,}"
