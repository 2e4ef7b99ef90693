"""Seeds added until a study has decided: above training and analysis, which know nothing of each other.

    plan of the next stage → train → contrasts with the baseline → decided, or the next stage

The stages and what each may spend of the error rate are fixed before the first run
(`pneuma.analysis.sequential`). Every condition is held against the study's baseline, by the mean share
of monsters killed at the last evaluation, or at the largest step count that all reach. The study's
record keeps that its seeds were chosen by looking: a claim reads only the seeds that it fixed itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pneuma.analysis.contrasts import Contrast, compare
from pneuma.analysis.outcomes import HALF_A_MONSTER, PRIMARY, outcome_values
from pneuma.analysis.run_index import open_study
from pneuma.analysis.run_view import common_step
from pneuma.analysis.sequential import Stage, decide, looked_at, make_stages
from pneuma.analysis.tables import StudyData
from pneuma.analysis.verdicts import found
from pneuma.config import stream_seed
from pneuma.errors import UserError
from pneuma.study import execute
from pneuma.study.plan import Plan, Selection, make_plan
from pneuma.study.spec import Study
from pneuma.study.store import Store


@dataclass(frozen=True)
class Finding:
    """How one condition stands against the baseline at a look.

    Attributes:
        condition: its name.
        contrast: of its runs against the baseline's.
        decided: "greater", "less" or "equal", now or at an earlier look; empty while undecided, and while
            runs are left out: those that are left may look too good.
        left_out: runs of both that have no such outcome.
    """

    condition: str
    contrast: Contrast
    decided: str
    left_out: int


@dataclass(frozen=True)
class Look:
    """One stage's end: all that was looked at."""

    stage: Stage
    findings: tuple[Finding, ...]

    @property
    def decided(self) -> bool:
        """Whether nothing is left open."""
        return all(finding.decided for finding in self.findings)


def run_until_decided(
    study: Study, selection: Selection, most_seeds: int, store: Store, train: Callable[[Plan], bool]
) -> Iterator[Look]:
    """Train a study in stages and look after each, until every contrast is decided or seeds run out.

    Args:
        study: the study.
        selection: what of it to run; its seeds are the stages'.
        most_seeds: of each condition, at the last stage.
        store: the results folder.
        train: trains what a plan lacks; False where it did not come to its end, and nothing is looked at.

    Raises:
        UserError: before anything is trained, where the selection has no two conditions to compare, or its
            runs were looked at by another plan; after the first stage, where no run has what they are
            compared by.
    """
    stages = make_stages(most_seeds)
    plans = [make_plan(study, replace(selection, seeds=tuple(range(s.seeds)))) for s in stages]
    others = compared(plans[0])
    recorded = store.selection(study.name) or {}
    _refuse_another_plan(recorded, stages, others, plans[-1])
    looks: list[Look] = []
    for stage, planned in zip(stages, plans, strict=True):
        if not train(planned):
            return
        record = execute.selection_record(planned)
        earlier = {f.condition: f.decided for f in looks[-1].findings} if looks else {}
        looks.append(_look(open_study(store, record), study.baseline, others, stage, earlier))
        now = {
            "outcome": PRIMARY,
            "margin": HALF_A_MONSTER,
            "stages": [stage.seeds for stage in stages],
            "conditions": list(others),
            "runs": sorted({cell.run_id for cell in planned.cells}),
            "looks": [look_document(look) for look in looks],
        }
        store.save_selection(study.name, {**record, "adaptive": now})
        yield looks[-1]
        if looks[-1].decided:
            return


def _refuse_another_plan(
    record: Mapping[str, Any], stages: Sequence[Stage], others: Sequence[str], whole: Plan
) -> None:
    """Refuse to look at runs again by other stages, or for other conditions: that spends alpha twice."""
    before = record.get("adaptive")
    if not before or not {cell.run_id for cell in whole.cells} & looked_at(record):
        return
    if before["stages"] != [stage.seeds for stage in stages] or before["conditions"] != list(others):
        at = ", ".join(str(look["seeds"]) for look in before["looks"])
        raise UserError(
            f"study {whole.study.name}: was looked at with {at} seeds by another --max-seeds or --condition; "
            "looking again would spend its error rate twice: give the same ones, or fix --seeds"
        )


def compared(planned: Plan) -> tuple[str, ...]:
    """Return the conditions that are held against the baseline; those of its own configuration are not.

    Raises:
        UserError: where there is no baseline, nothing to compare with it, or another engine in it.
    """
    baseline = planned.study.baseline
    if baseline not in planned.conditions:
        raise UserError(f"--until-decided compares with the baseline: add --condition {baseline}")
    same = {name for names in planned.same if baseline in names for name in names}
    others = tuple(name for name in planned.conditions if name != baseline and name not in same)
    if not others:
        raise UserError(
            f"--until-decided: study {planned.study.name} has no condition to compare with {baseline}"
        )
    engines = {cell.condition: cell.run.engine for cell in planned.cells}
    for name in others:
        if engines[name] != engines[baseline]:
            raise UserError(
                f"--until-decided: {name} is trained by {engines[name]}, {baseline} by {engines[baseline]}: "
                "choose one with --engine"
            )
    return others


def _look(
    data: StudyData, baseline: str, others: tuple[str, ...], stage: Stage, earlier: Mapping[str, str]
) -> Look:
    at_step = common_step(data)
    base = outcome_values(data, baseline, PRIMARY, at_step)
    arms = {name: outcome_values(data, name, PRIMARY, at_step) for name in others}
    if not np.isfinite(np.concatenate([base, *arms.values()])).any():
        raise UserError(
            f"--until-decided compares by {PRIMARY}, which no run of study {data.study} has; "
            "give a number of --seeds"
        )
    had = {name: values[np.isfinite(values)] for name, values in (*arms.items(), ("", base))}
    contrasts = {}
    for name in others:  # each with its own draws, so that none depends on which others there are
        generator = np.random.default_rng(stream_seed(f"until-decided/{stage.seeds}", name))
        contrasts[name] = compare("mean", had[name], had[""], HALF_A_MONSTER, generator)
    decided = decide(stage, [contrast.p_any for contrast in contrasts.values()])
    findings = []
    for (name, contrast), now in zip(contrasts.items(), decided, strict=True):
        left_out = arms[name].size + base.size - sum(contrast.seeds)
        new = found(contrast) if now and not left_out else ""
        findings.append(Finding(name, contrast, earlier.get(name) or new, left_out))
    return Look(stage, tuple(findings))


def look_document(look: Look) -> dict[str, Any]:
    """Return a look as JSON holds it."""
    return {
        "seeds": look.stage.seeds,
        "alpha": look.stage.alpha,
        "contrasts": [
            {
                "condition": finding.condition,
                "effect": finding.contrast.effect if np.isfinite(finding.contrast.effect) else None,
                "p": finding.contrast.p_any,
                "decided": finding.decided or None,
                "left_out": finding.left_out,
            }
            for finding in look.findings
        ],
    }
