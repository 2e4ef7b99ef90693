"""A small study, a claim on it, and runs of which an outcome is known, for tests of verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pneuma.analysis.claims.claim_list import load_claims
from pneuma.analysis.claims.verdicts import Verdict, judge
from pneuma.config import Run, as_fields
from pneuma.store.index import RunIndex
from pneuma.store.published import encode_published
from pneuma.store.row_builder import stored_row
from pneuma.store.store import Store
from pneuma.study.identity import config_id, run_id
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study

from .. import hand_made

STUDY = """\
title = "Mine"
base = "table-6-2"

[conditions.low]
epochs = 5

[conditions.high]
epochs = 6

[conditions.middle]
epochs = 7

[conditions.low-too]
epochs = 5

[conditions.other]
epochs = 8

[conditions.reference]
epochs = 6
engine = "sb3"

[conditions.paid-for-kills]
epochs = 6
reward = "kills"

[presets.quick]
seeds = 3
steps = 1024
"""

CLAIMS = """\
[defaults]
seeds = 8
steps = 1024

[claims.better]
quote = "a quote"
section = "6"
study = "mine.toml"
a = "high"
b = "low"
outcome = "final-share-killed"
kind = "mean"
direction = "greater"
margin = 0.04
worlds = ["text"]
"""

BETTER = CLAIMS[CLAIMS.index("[claims.better]") :]
"""The claim without the defaults, for lists of several."""

LOW = [0.20, 0.21, 0.22, 0.23, 0.24, 0.25, 0.26, 0.27]
HIGH = [share + 0.5 for share in LOW]
NEAR = [share + 0.001 for share in LOW]
"""Shares killed by eight runs of a condition."""


def write_files(folder: Path, claims: str = CLAIMS) -> Path:
    """Write study and claims into a folder; return the path of the claims."""
    (folder / "mine.toml").write_text(STUDY, encoding="utf-8")
    path = folder / "claims.toml"
    path.write_text(claims, encoding="utf-8")
    return path


def save_runs(
    store: Store,
    folder: Path,
    shares: Mapping[str, Sequence[float | Sequence[float]]],
    world: str = "text",
    returns: Sequence[float] = (),
    **provenance: object,
) -> list[str]:
    """Store a run for each share killed, as `save_run` takes it, seed by seed; return the runs' ids."""
    (folder / "mine.toml").write_text(STUDY)
    study = load_study(str(folder / "mine.toml"), world)
    ids = []
    for condition, values in shares.items():
        query = Query(preset="quick", seeds=tuple(range(len(values))), conditions=(condition,))
        for i, (cell, share) in enumerate(zip(make_plan(study, query).cells, values, strict=True)):
            own = returns[i] if returns else None
            save_run(store, cell.run, share, own, **provenance)
            ids.append(cell.run_id)
    return ids


def save_run(
    store: Store,
    run: Run,
    shares: float | Sequence[float],
    returned: float | None = None,
    **provenance: Any,
) -> None:
    """Store a run of one evaluation, or of several at even steps.

    What they kill is their score too, and the share of their steps with the commonest action.
    """
    curve = shares if isinstance(shares, Sequence) else [shares]
    columns = ("share_killed", "score", "commonest_action")
    evaluations = [
        {"step": run.steps * k // len(curve), **dict.fromkeys(columns, own)}
        for k, own in enumerate(curve, start=1)
    ]
    episode = {"step": run.steps, "return": curve[-1] if returned is None else returned, "length": 9}
    rows = [episode], [{"step": run.steps, "entropy": 1.0}], evaluations
    about: dict[str, Any] = {"fields": as_fields(run), "config_id": config_id(run), **provenance}
    hand_made.save_run(store, run_id(run), *rows, run.steps, **about)


def published_alone(store: Store, folder: Path, study: str) -> Store:
    """Publish all runs as a study's table; return a store of tables alone, as a clone has."""
    clone = Store(folder / "clone")
    rows = [stored_row(store, name) for name in store.runs()]
    about = {"study": study, "world": "text", "settings": {}}
    clone.write(clone.published_path(study), encode_published(rows, about))
    return clone


def judge_claims(store: Store, folder: Path, claims: str = CLAIMS) -> list[Verdict]:
    """Write study and claims into a folder, and judge these by the runs of a store."""
    return judge(load_claims(write_files(folder, claims)), RunIndex(store, shipped=False))


def judge_one(store: Store, folder: Path, claims: str = CLAIMS) -> Verdict:
    """Judge the one claim that there is, in the text's world."""
    (one,) = [own for own in judge_claims(store, folder, claims) if own.world == "text"]
    return one


def changed(*pairs: tuple[str, str]) -> str:
    """Return the claim with each text, which stands there once, replaced."""
    text = CLAIMS
    for old, new in pairs:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text
