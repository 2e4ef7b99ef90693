"""The runs that claims fix, found by configuration, seed and steps; and of a study, as a preset to train.

An arm has one value per run, or the reason why its runs cannot be compared.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pneuma.analysis.claims.claim_list import Claim, ClaimList, load_claims
from pneuma.analysis.intervals import mean_interval
from pneuma.analysis.outcomes import (
    MIN_CPU_SHARE,
    find_outcome,
    is_return,
    outcome,
    reason,
    unit_of_return,
)
from pneuma.analysis.runs import finished_rows, runs_of_plan
from pneuma.config import Run, round_up
from pneuma.errors import UserError
from pneuma.presets import world_option
from pneuma.store.index import RunIndex
from pneuma.store.provenance import processors
from pneuma.store.rows import Row
from pneuma.study.identity import config_id
from pneuma.study.plan import Cell, Plan, configure
from pneuma.study.shipped import CLAIMS_FILE, CLAIMS_FILES
from pneuma.study.spec import CLAIMS, Amount, Preset, Study, results_words
from pneuma.values import shown_seeds

TRAIN_WITH = "train with:"
"""The beginning of the part of a reason that names the command."""

FLOOR_LEVEL = 0.05
"""The chance that an arm that plays like the random player is said to play better."""


@dataclass(frozen=True)
class Arm:
    """One arm of a contrast.

    Attributes:
        values: (seeds,) the outcome of each run that counts, in the order of seeds; 1 or 0 if runs with an
            event are counted. Of a hazard (2, seeds): steps, and whether they are those of an event.
        reason: why it cannot be compared, if a run has no value.
        learned: whether it is shown to play better than the random player; None if unknown.
        other_values: (seeds,) another outcome of the same runs, if that is compared.
    """

    values: np.ndarray
    reason: str
    learned: bool | None
    other_values: np.ndarray = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class ClaimRuns:
    """The runs that a claim fixed in one world.

    Attributes:
        configurations: of each condition that is compared.
        rows: their finished runs, in the order of seeds; there may be none.
        remedy: the end of a reason if runs are missing, with the command that trains them.
    """

    claim: Claim
    world: str
    configurations: Mapping[str, Run]
    rows: Mapping[str, Sequence[Row]]
    remedy: str
    problems: Sequence[str] = ()

    @property
    def commits(self) -> tuple[str, ...]:
        """The commits of the code that trained them."""
        commits: set[str] = set()
        for origin in [row.provenance for rows in self.rows.values() for row in rows]:
            for source in (origin, origin.get("project")):  # Pneuma's code, and the user's own studies
                if isinstance(source, dict):
                    commits.add(str(source.get("commit")).removesuffix("-dirty"))
        return tuple(sorted(commits))

    def budget(self, condition: str) -> int:
        return round_up(self.configurations[condition], self.claim.steps)

    def why_incomparable(self, name: str, conditions: Sequence[str]) -> str:
        """Return why arms cannot be compared by an outcome, before any value is read; empty if they can."""
        if len({config_id(self.configurations[condition]) for condition in conditions}) < len(conditions):
            return f"A/A: {' and '.join(conditions)} resolve to the same configuration"
        engines = [self.configurations[condition].engine for condition in conditions]
        if len({*engines}) > 1:
            mixed = ", ".join(map("{} by {}".format, conditions, engines))
            return f"engines are mixed: {mixed}"
        missing = [text for text in map(self._missing, conditions) if text]
        if missing:
            return "; ".join([*missing, self.remedy])
        rows = [row for condition in conditions for row in self.rows[condition]]
        if is_return(name) and len({unit_of_return(row) for row in rows}) > 1:
            return "returns of unlike rewards"
        return _why_not_timed(rows) if find_outcome(name).source == "times" else ""

    def _missing(self, condition: str) -> str:
        fixed, stored = len(self.claim.seeds_of(condition)), len(self.rows[condition])
        if stored == fixed:
            return ""
        steps = f"{self.budget(condition):,} steps"
        steps += "".join(f" ({problem})" for problem in self.problems)
        if stored:
            return f"runs missing: {condition} has {stored} of the {fixed} fixed ones with {steps}"
        return f"no runs: {condition}, {fixed} seeds of {steps}"

    def arm(self, name: str, condition: str, other: str = "") -> Arm:
        """Return an arm: an outcome of each run of a condition, whose runs have all finished, or two."""
        rows = self.rows[condition]
        values = np.array([outcome(row, name) for row in rows])
        no_value = ""
        for row, value in zip(rows, values, strict=True):
            if np.isnan(value):
                no_value = f"{condition} seed {row.seed}: {reason(row, name)}"
                break
        if self.claim.kind == "hazard":
            last_seen = [row.evaluations("step")[-1] for row in rows]
            return Arm(np.array([np.minimum(values, last_seen), np.isfinite(values)]), no_value, None)
        if self.claim.is_incidence:
            values = self.claim.has_event(name, values).astype(float)
        # steps to what is never reached are at least those of the run
        values = np.where(np.isinf(values), self.budget(condition), values)
        other_values = np.array([outcome(row, other) for row in rows] if other else ())
        return Arm(values, no_value, _has_learned(rows), other_values)


def _why_not_timed(rows: Sequence[Row]) -> str:
    """Return why times cannot be compared (machines differ, or did other work); empty if they can."""
    machines = {
        (processor, str(row.provenance.get("threads")))
        for row in rows
        for processor in processors(row.provenance)
    }
    if len(machines) > 1:
        return "timed on different machines"
    shares = [row.processor_share for row in rows if row.processor_share is not None]
    if shares and min(shares) < MIN_CPU_SHARE:
        return f"timed beside other work: on {min(shares):.0%} of a core"
    return ""


def _has_learned(rows: Sequence[Row]) -> bool | None:
    """Return whether an arm plays better than the random player: its interval of the mean is above it.

    Of each run its mean score over all evaluations counts, where 0 is the random player; the greatest score
    would be above 0 by chance alone. None if a run has no score.
    """
    means = []
    for row in rows:
        _, scores = row.known_evaluations("score")
        means.append(scores.mean() if len(scores) else np.nan)
    if not np.isfinite(means).all() or len(means) < 2:
        return None
    interval = mean_interval(means, 1 - 2 * FLOOR_LEVEL)
    return interval.low > 0 if interval.exists else bool(np.mean(means) > 0)


# --- Finding runs ----------------------------------------------------------------------------------


def find_claim_runs(index: RunIndex, claims: ClaimList, claim: Claim, world: str) -> ClaimRuns:
    """Return the finished runs of a claim in one of its worlds."""
    study = claims.studies[claim.study].in_world(world)
    configurations = configure(study, {}, claim.compared, index.engine_of).runs
    cells: list[Cell] = []
    for condition, run in configurations.items():
        steps = round_up(run, claim.steps)
        for seed in claim.seeds_of(condition):
            cells.append(Cell(condition, seed, replace(run, seed=seed, steps=steps)))
    data = finished_rows(index, runs_of_plan(index, Plan(study, tuple(cells))))
    rows = {condition: data.of_condition(condition) for condition in configurations}
    rest = results_words(index.store.root)
    if any(row.published for row in data.rows):
        rest.append("--unpublished")
    commands = [shlex.join([*words, *rest]) for words in training_commands(claims, claim, study)]
    remedy = f"{TRAIN_WITH} {' && '.join(commands)}"
    return ClaimRuns(claim, world, configurations, rows, remedy, index.problems)


def training_commands(claims: ClaimList, claim: Claim, study: Study) -> list[list[str]]:
    """Return commands, as words, that train a claim's runs: by a preset if the list is beside the study."""
    words = ["pneuma", "study", "run", study.own_path or study.name]
    world = world_option(study.world, study.worlds)
    if claim.preset:
        return [[*words, "--preset", claim.preset, *world]]
    if study.path and claims.path.resolve() == (study.path.parent / CLAIMS_FILE).resolve():
        budgets = {
            other.steps
            for other in claims.claims.values()
            if other.study == claim.study and study.world in other.worlds
        }
        steps = ["--steps", str(claim.steps)] if len(budgets) > 1 else []
        return [[*words, "--preset", CLAIMS, *world, *steps]]
    conditions_by_seeds: dict[str, list[str]] = {}
    for condition in claim.conditions:
        options = conditions_by_seeds.setdefault(shown_seeds(claim.seeds_of(condition)), [])
        options += ["--condition", condition]
    return [
        [*words, *world, *options, "--seeds", seeds, "--steps", str(claim.steps)]
        for seeds, options in conditions_by_seeds.items()
    ]


# --- The preset `claims`: runs to train ----------------------------------------------------------------


def with_claims(study: Study, steps: int | None = None) -> Study:
    """Return a study with the preset `claims`: the runs that claims beside its file fix in its world.

    Conditions without a claim are left out. A condition of several claims has the seeds of all of them. If
    claims fix several budgets, `steps` chooses one; any other number chooses the conditions of all.

    Raises:
        UserError: when no claim is about the study, or several budgets are possible.
    """
    amounts = fixed_amounts(study)
    if not amounts:
        raise UserError(
            f"--preset {CLAIMS}: no {CLAIMS_FILE} beside study {study.name} has a claim on it in this world"
        )
    if len(amounts) > 1 and steps is None:
        budgets = " or ".join(f"{budget:,}" for budget in amounts)
        raise UserError(f"--preset {CLAIMS}: claims fix runs of {budgets} steps: say which with --steps")
    steps = steps or next(iter(amounts))
    conditions: dict[str, Amount] = {}
    for by_condition in [amounts[steps]] if steps in amounts else amounts.values():
        conditions |= by_condition
    preset = Preset.model_construct(seeds=(), steps=steps, conditions=conditions)
    return study.model_copy(update={"presets": {**study.presets, CLAIMS: preset}})


def fixed_amounts(study: Study) -> dict[int, dict[str, Amount]]:
    """Return seeds and steps of each condition by number of steps; empty if no claim is about the study."""
    seeds: dict[int, dict[str, set[int]]] = {}
    for _, claim in claims_on(study):
        by_condition = seeds.setdefault(claim.steps, {})
        for condition in claim.conditions:
            by_condition.setdefault(condition, set()).update(claim.seeds_of(condition))
    amounts: dict[int, dict[str, Amount]] = {}
    for steps, by_condition in seeds.items():
        amounts[steps] = {}
        for condition in study.conditions:
            if condition in by_condition:
                fixed = tuple(sorted(by_condition[condition]))
                amounts[steps][condition] = Amount.model_construct(seeds=fixed, steps=steps)
    return amounts


def claims_on(study: Study) -> Iterator[tuple[ClaimList, Claim]]:
    """Yield the claims on a study in its world, each with its list, of all lists beside the study's file."""
    if study.path is None:
        return
    for path in (study.path.parent / name for name in CLAIMS_FILES):
        claim_list = load_claims(path) if path.exists() else None
        for claim in claim_list.claims.values() if claim_list else ():
            is_file = (path.parent / claim.study).resolve() == study.path.resolve()
            is_shipped = study.own_path is None and claim.study == study.path.stem
            if claim_list and (is_file or is_shipped) and study.world in claim.worlds:
                yield claim_list, claim
