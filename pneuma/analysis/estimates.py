"""How long runs take, by the published runs of the same configuration."""

from __future__ import annotations

from pneuma.config import Run
from pneuma.store.index import RunIndex
from pneuma.study.identity import config_id
from pneuma.training.progress import START_SECONDS


def published_seconds(index: RunIndex, run: Run, steps: int) -> float | None:
    """Return the seconds that steps of a run took on the machine that made the published runs.

    Learning takes as long as there are steps; evaluations are as many in a run of any length.

    Args:
        index: published runs are read from it.
        run: what is to be trained.
        steps: how many of its steps are left.

    Returns:
        Seconds of one process; None if no run of its configuration is published.
    """
    runs = index.frame.iloc[[*index.places.get(config_id(run), ())]]
    for run_id in runs["run_id"][runs["where"] != ""]:
        row = index.row(run_id)
        if row is None or not row.wall_seconds:
            continue
        share = row.provenance.get("evaluation_share")
        evaluating = row.wall_seconds * (share if isinstance(share, float) else 0.0)
        learning = (row.wall_seconds - evaluating) / row.end
        return START_SECONDS + evaluating * steps / run.steps + learning * steps
    return None
