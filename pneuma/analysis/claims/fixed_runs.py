"""The finished runs that a claim fixes."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from pneuma.analysis.claims.claim_list import RULES, Claim
from pneuma.analysis.intervals import mean_interval
from pneuma.analysis.outcomes import find_outcome, outcome_values, reason, unit_of_return
from pneuma.analysis.runs import finished_rows, runs_of_plan
from pneuma.analysis.study_data import StudyData
from pneuma.seeds import seeds_option
from pneuma.store.index import RunIndex
from pneuma.store.rows import Row
from pneuma.study.command_words import results_words, study_words
from pneuma.study.identity import config_id
from pneuma.study.plan import Cell, Plan, configure
from pneuma.study.spec import Study

TRAIN_WITH = "train with:"
"""The beginning of the part of a reason that names the command."""

FLOOR_LEVEL = 0.05
"""The chance that a condition is found to play better than the random player if it does not."""


@dataclass(frozen=True, eq=False)
class ClaimRuns:
    """The runs that a claim fixed in one world.

    Attributes:
        data: the finished ones, of the conditions that are compared; there may be none.
        folder: of results, in which runs are missing.
    """

    claim: Claim
    data: StudyData
    folder: Path
    _values: dict[tuple[str, str], np.ndarray] = field(default_factory=dict, repr=False)

    @property
    def world(self) -> str:
        return self.data.study.world

    @property
    def commits(self) -> tuple[str, ...]:
        """The commits of the code that trained them."""
        commits: set[str] = set()
        for row in self.data.rows:
            # Pneuma's code, and the user's own studies
            for provenance in (row.provenance, row.provenance.get("project")):
                if isinstance(provenance, dict):
                    commits.add(str(provenance.get("commit")).removesuffix("-dirty"))
        return tuple(sorted(commits))

    @cached_property
    def learned(self) -> Mapping[str, bool | None]:
        """Whether each condition is shown to play better than the random player: its interval is above it.

        Of each run its mean score over all evaluations counts, where 0 is the random player; the greatest
        score would be above 0 by chance alone. None if a run has no score.
        """
        learned: dict[str, bool | None] = {}
        for condition in self.data.conditions:
            run_scores = [row.evaluation_points("score")[1] for row in self.data.of_condition(condition)]
            learned[condition] = None
            if len(run_scores) > 1 and all(map(len, run_scores)):
                mean_scores = np.array(list(map(np.mean, run_scores)))
                interval = mean_interval(mean_scores, 1 - 2 * FLOOR_LEVEL)
                # without an interval all are equal
                learned[condition] = bool(interval.low > 0 or not interval.exists and mean_scores[0] > 0)
        return learned

    def why_incomparable(self, outcome_names: Sequence[str], conditions: Sequence[str]) -> str:
        """Return why conditions cannot be compared by some outcomes; empty if they can."""
        claim = self.claim
        runs = {condition: self.data.configurations[condition] for condition in conditions}
        if len(set(map(config_id, runs.values()))) < len(runs):
            return f"what is compared is the same: {' and '.join(conditions)} have one configuration"
        if len({run.engine for run in runs.values()}) > 1:
            engines = [f"{condition} by {run.engine}" for condition, run in runs.items()]
            return f"trained by different engines: {', '.join(engines)}"
        rows: list[Row] = []
        missing_runs: list[str] = []
        for condition in runs:
            condition_rows, seeds = self.data.of_condition(condition), claim.seeds_of(condition)
            rows += condition_rows
            if len(condition_rows) < len(seeds):
                fixed_runs = f"{len(seeds)} fixed ones with {claim.steps:,} steps"
                missing_runs.append(
                    f"runs missing: {condition} has {len(condition_rows)} of the {fixed_runs}"
                )
        if missing_runs:
            return f"{'; '.join(missing_runs)}; {TRAIN_WITH} {self.training_command}"
        for outcome_name in outcome_names:
            if find_outcome(outcome_name).is_return and len(set(map(unit_of_return, rows))) > 1:
                return "returns of unlike rewards"
            for condition in conditions:
                run_values = self._outcome_values(outcome_name, condition)
                for row, run_value in zip(self.data.of_condition(condition), run_values, strict=True):
                    if np.isnan(run_value):
                        run_name = f"{condition} seed {row.seed}"
                        return f"a run has no value: {run_name}: {reason(row, outcome_name)}"
        return ""

    @property
    def training_command(self) -> str:
        """The command that trains the missing runs: by a preset, or all conditions and seeds."""
        claim = self.claim
        command_words = ["pneuma", "study", "run"] + study_words(self.data.study)
        if claim.preset:
            command_words += ["--preset", claim.preset]
        else:
            seeds: set[int] = set()
            for condition in claim.conditions:
                command_words += ["--condition", condition]
                seeds.update(claim.seeds_of(condition))
            command_words += ["--seeds", seeds_option(seeds), "--steps", str(claim.steps)]
        if any(row.published for row in self.data.rows):
            command_words.append("--unpublished")
        return shlex.join(command_words + results_words(self.folder))

    def values(self, outcome_name: str, condition: str, rules: int = RULES) -> np.ndarray:
        """Return an outcome of each run of a condition, whose runs have all finished and have one.

        It is (seeds,) in the order of seeds; 1 or 0 if runs with an event are counted. Of a hazard it is
        (2, seeds): steps, and whether they are those of an event.
        """
        rows = self.data.of_condition(condition)
        run_values = self._outcome_values(outcome_name, condition)
        if outcome_name.startswith("steps-to") and rules < RULES:
            run_values = np.array(
                [_at_evaluation(row, outcome_name, step) for row, step in zip(rows, run_values, strict=True)]
            )
        if self.claim.kind == "hazard":
            last_seen = [row.evaluations("step")[-1] for row in rows]
            return np.array([np.minimum(run_values, last_seen), np.isfinite(run_values)])
        if self.claim.is_incidence:
            return self.claim.has_event(run_values).astype(float)
        # steps to what is never reached are at least those of the run
        return np.where(np.isinf(run_values), [row.budget for row in rows], run_values)

    def _outcome_values(self, outcome_name: str, condition: str) -> np.ndarray:
        """Return an outcome of each run of a condition, (seeds,), computed once."""
        values_key = outcome_name, condition
        if values_key not in self._values:
            self._values[values_key] = outcome_values(self.data, condition, outcome_name)
        return self._values[values_key]


def _at_evaluation(row: Row, outcome_name: str, step: float) -> float:
    """Return the first evaluation at or after a step, which counted before version 6 of the rules."""
    evaluation_steps, _ = row.evaluation_points(find_outcome(outcome_name).column)
    following_steps = evaluation_steps[evaluation_steps >= step]
    return float(following_steps[0]) if len(following_steps) else np.inf


def find_claim_runs(index: RunIndex, study: Study, claim: Claim) -> ClaimRuns:
    """Return the finished runs of a claim on a study, which is in one of its worlds."""
    cells: list[Cell] = []
    configurations = configure(study, {}, list(claim.a + claim.b), index.engine_of).runs
    for condition, run in configurations.items():
        for seed in claim.seeds_of(condition):
            cells.append(Cell(condition, seed, replace(run, seed=seed, steps=claim.steps)))
    study_data = finished_rows(index, runs_of_plan(index, Plan(study, tuple(cells)), registered=True))
    return ClaimRuns(claim, study_data, index.store.root)
