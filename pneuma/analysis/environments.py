"""Studies of several environments: their runs in each, and scores over all (Agarwal et al. 2021).

    StudyData → `by_environment` → StudyData of each environment, with conditions of the same names
    → scores on a common scale → `over_environments`, `improvements`, `profile_scores`

A run's score is its outcome on the scale of its environment, on which 0 and 1 are two reference scores.
Statistics are rliable's; they take the scores of one condition, or of many resamples of them. Intervals are
of the stratified bootstrap: runs are resampled within each environment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from pneuma.analysis.answer import Answer
from pneuma.analysis.drawing import condition_table, drawing_of
from pneuma.analysis.intervals import LEVEL, interquartile_mean, probability_of_improvement
from pneuma.analysis.notes import notes_on_ends
from pneuma.analysis.outcomes import find_outcome, known_values
from pneuma.analysis.study_data import StudyData
from pneuma.errors import Hint, UserError

OUTCOME = "evaluated-return"
"""The outcome that scores are made of by default."""
LEAST_TO_RESAMPLE, RESAMPLES = 3, 10_000
PROFILE_POINTS = 200
"""Of a performance profile, whose band is of a tenth of the resamples."""
Parts = Mapping[str, StudyData]
"""A study's runs in each environment, by its id."""
Scores = Sequence[np.ndarray]
"""(…, runs) for each environment."""
Statistic = Callable[..., np.ndarray]


def by_environment(study_data: StudyData) -> dict[str, StudyData]:
    """Return a study's runs in each of its environments; a single part if there is one environment.

    Conditions are called by all that they are crossed with except the environment, so that those of different
    environments have the same names.
    """
    study = study_data.study
    levels: dict[str, dict[str, str]] = {}
    names_by_env: dict[str, dict[str, str]] = {}
    for condition, fields in study_data.fields.items():
        levels[condition], level_names = {}, []
        for factor, level in study.levels.get(condition, {}).items():
            if any("env" in set_fields for set_fields in study.factors.get(factor, {}).values()):
                continue
            levels[condition][factor] = level
            with_factor = f"{factor}={level}"  # where values have no names
            level_names.append(with_factor if with_factor in condition else level)
        names_by_env.setdefault(str(fields.get("env")), {})[condition] = ", ".join(level_names) or condition
    if study.levels:
        study_data = replace(
            study_data, study=study.model_copy(update={"levels": {**study.levels, **levels}})
        )
    return {env: study_data.renamed(names_in_env) for env, names_in_env in names_by_env.items()}


def environment_names(study_data: StudyData) -> dict[str, str]:
    """Return what people call each environment: its value of a factor, with its label, or else its id."""
    names_by_env: dict[str, set[str]] = {}
    for condition, fields in study_data.fields.items():
        names = names_by_env.setdefault(str(fields.get("env")), set())
        for factor, level in study_data.study.levels.get(condition, {}).items():
            if "env" in study_data.study.factors.get(factor, {}).get(level, {}):
                names.add(study_data.labelled(level, factor))
    all_names = [name for names in names_by_env.values() for name in names]
    if len(all_names) == len(names_by_env) == len(set(all_names)):
        return {env: name for env, (name,) in names_by_env.items()}
    return {env: env for env in names_by_env}


def columns_of(study_data: StudyData) -> dict[str, StudyData]:
    """Return a study's runs in each environment that has some, by its name; "" if it is a single one."""
    names, columns = environment_names(study_data), {}
    for env, env_data in by_environment(study_data).items():
        if env_data.rows:
            columns[names[env]] = env_data
    return columns if len(columns) > 1 else {"": study_data}


def in_environment_of(study_data: StudyData, other_data: StudyData) -> StudyData | None:
    """Return another study's runs in a study's environment; None without any.

    Those of logs are returned as they are, because logs do not contain their environment.
    """
    if study_data.averaged_over or other_data.averaged_over:
        return other_data
    data_by_env = by_environment(other_data)
    for env, env_data in data_by_env.items():
        if env in study_data.environments:
            return other_data if len(data_by_env) == 1 else env_data
    return None


def references(data_by_env: Parts, outcome: str = OUTCOME) -> dict[str, tuple[float, float]]:
    """Return the outcomes that are scores of 0 and 1 in each environment.

    They are those of [scores] in the study's file, or else the mean return of the random player's episodes,
    and the best condition's mean.

    Raises:
        UserError: when the two are equal, or not known.
    """
    scales_by_env = {}
    for env, env_data in data_by_env.items():
        scale = env_data.study.scores.get(env)
        if scale:
            low, high = scale.random, scale.expert
        else:
            low = high = np.nan
            if "random_return" in env_data.evaluations:
                low = float(env_data.evaluations["random_return"].mean())
            for condition in env_data.conditions:
                run_values = known_values(env_data, condition, outcome)
                if len(run_values):
                    high = float(np.fmax(high, run_values.mean()))
        if not np.isfinite([low, high]).all() or low == high:
            fix = f'"{env}" = {{ random = …, expert = … }} under [scores] in the study\'s file'
            raise UserError(f"{env}: cannot be scaled from {low:g} to {high:g}: give {fix}")
        scales_by_env[env] = low, high
    return scales_by_env


def scores(data_by_env: Parts, outcome: str = OUTCOME) -> dict[str, list[np.ndarray]]:
    """Return the scores of each condition that has runs in every environment: (runs,) by environment."""
    scores_by_condition: dict[str, list[np.ndarray]] = {}
    for env, (low, high) in references(data_by_env, outcome).items():
        for condition in data_by_env[env].conditions:
            run_values = known_values(data_by_env[env], condition, outcome)
            if len(run_values):
                scores_by_condition.setdefault(condition, []).append((run_values - low) / (high - low))
    return {
        name: scores_by_env
        for name, scores_by_env in scores_by_condition.items()
        if len(scores_by_env) == len(data_by_env)
    }


def over_environments(data_by_env: Parts, outcome: str = OUTCOME) -> pd.DataFrame:
    """Return condition, statistic, value, low, high: one row for each of `AGGREGATES`."""
    rows = []
    for condition, env_scores in scores(data_by_env, outcome).items():
        for statistic, aggregate in AGGREGATES.items():
            low, high = bootstrap(aggregate, env_scores)
            rows.append((condition, statistic, float(aggregate(env_scores)), low, high))
    return pd.DataFrame(rows, columns=["condition", "statistic", "value", "low", "high"])


def profiles(data_by_env: Parts, outcome: str = OUTCOME) -> pd.DataFrame:
    """Return the share of runs with a score above each x: condition, x, share, low, high, runs."""
    scores_by_condition = scores(data_by_env, outcome)
    if not scores_by_condition:
        raise UserError(f"no condition has runs in every environment: {', '.join(data_by_env)}")
    all_scores = list(map(np.concatenate, scores_by_condition.values()))
    ends = np.concatenate([[0.0, 1.0], *all_scores])
    thresholds = np.linspace(ends.min(), ends.max(), PROFILE_POINTS)
    share_above, profile_frames = partial(profile, thresholds=thresholds), []
    for condition, env_scores in scores_by_condition.items():
        low, high = bootstrap(share_above, env_scores, resamples=RESAMPLES // 10)
        runs = ", ".join(str(len(run_scores)) for run_scores in env_scores)
        curve = {"x": thresholds, "share": share_above(env_scores), "low": low, "high": high}
        profile_frames.append(pd.DataFrame({"condition": condition, **curve, "runs": runs}))
    return pd.concat(profile_frames, ignore_index=True)


def improvements(data_by_env: Parts, a: str, b: str, outcome: str = OUTCOME) -> pd.DataFrame:
    """Return how likely a run of `a` is above one of `b` over all environments, and differences of scores."""
    scores_by_condition = scores(data_by_env, outcome)
    for name in (a, b):
        if name not in scores_by_condition:
            candidates = ", ".join(scores_by_condition) or "none"
            raise UserError(f"{name}: has no runs in every environment; these conditions have: {candidates}")
    statistics: dict[str, Statistic] = {"P(better)": improvement}
    for name, aggregate in AGGREGATES.items():
        statistics[f"{name}, difference"] = partial(_difference, aggregate)
    scores_a, scores_b = scores_by_condition[a], scores_by_condition[b]
    rows = []
    for name, statistic in statistics.items():
        low, high = bootstrap(statistic, scores_a, scores_b)
        rows.append((name, float(statistic(scores_a, scores_b)), low, high))
    return pd.DataFrame(rows, columns=["statistic", "value", "low", "high"])


# --- Statistics --------------------------------------------------------------------------------------


def _means(scores: Scores) -> list[np.ndarray]:
    return [runs.mean(axis=-1) for runs in scores]


def _mean(scores: Scores) -> np.ndarray:
    return np.mean(_means(scores), axis=0)


def _median(scores: Scores) -> np.ndarray:
    return np.median(_means(scores), axis=0)


def _middle_mean(scores: Scores) -> np.ndarray:
    return interquartile_mean(np.concatenate(scores, axis=-1))


def _optimality_gap(scores: Scores) -> np.ndarray:
    runs = np.concatenate(scores, axis=-1)
    return 1 - np.minimum(runs, 1).mean(axis=-1)


AGGREGATES: Mapping[str, Statistic] = {
    "mean": _mean,
    "median": _median,
    "IQM": _middle_mean,
    "optimality gap": _optimality_gap,
}
"""Mean and median over environments of means over runs; the mean of the middle half of all runs; and by how
much all miss a score of 1, in the mean, where what lies above 1 does not count."""


def profile(scores: Scores, thresholds: np.ndarray) -> np.ndarray:
    """Return the share of all runs with scores above each threshold: (…, thresholds)."""
    runs = np.concatenate(scores, axis=-1)
    return (runs[..., None, :] > thresholds[:, None]).mean(axis=-1)


def improvement(a: Scores, b: Scores) -> np.ndarray:
    """Return the probability that a run of `a` is above one of `b` in the same environment, a tie a half.

    The mean over environments, which stand in the same order in both.
    """
    return np.mean(list(map(probability_of_improvement, a, b)), axis=0)


def _difference(aggregate: Statistic, a: Scores, b: Scores) -> np.ndarray:
    return aggregate(a) - aggregate(b)


def bootstrap(statistic: Statistic, *groups: Scores, resamples: int = RESAMPLES) -> np.ndarray:
    """Return the ends of a statistic's 95 % interval, (2, …); NaN if an environment has too few runs."""
    generator = np.random.default_rng(0)
    resampled: list[list[np.ndarray]] = []
    for group in groups:
        resampled.append([])
        for runs in group:
            if len(runs) < LEAST_TO_RESAMPLE:
                return np.full((2, *np.shape(statistic(*groups))), np.nan)
            run_indices = generator.integers(len(runs), size=(resamples, len(runs)))
            resampled[-1].append(runs[run_indices])
    return np.quantile(statistic(*resampled), [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)


# --- Performance profiles ---------------------------------------------------------------------------


def profile_scores(study_data: StudyData) -> Answer:
    """Return the share of runs above each score, over all environments together.

    Returns:
        The table `profiles` has condition, x, share, low, high and runs.

    Raises:
        UserError: for a study of one environment, or scores without a scale.
    """
    data_by_env = by_environment(study_data)
    if len(data_by_env) == 1:
        raise UserError(
            Hint("figure", "profile"), f": is over several environments; {study_data.study.name} has one"
        )
    profile_table = profiles(data_by_env)
    scale_texts: list[str] = []
    for env, (low, high) in references(data_by_env).items():
        scale_text = f"{low:.3g} and {high:.3g}".replace("-", "−") + f" in {env}"
        if env not in study_data.study.scores:
            scale_text += " (random player, best condition)"
        scale_texts.append(scale_text)
    scale_note = f"Score: {find_outcome(OUTCOME).words}; 0 and 1 are {', '.join(scale_texts)}."
    cells = profile_table[["condition", "runs"]].drop_duplicates()
    return Answer(
        study_data.full_title,
        study_data.about,
        {"profiles": profile_table},
        [cells],
        [scale_note] + notes_on_ends(study_data),
        drawing=drawing_of({"": study_data}, "profile", conditions=condition_table(data_by_env)),
    )
