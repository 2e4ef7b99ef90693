"""Performance profiles of a study of several environments (Agarwal et al. 2021)."""

from __future__ import annotations

from pneuma.analysis.environments import OUTCOME, by_environment, profiles, references
from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.study_data import StudyData
from pneuma.answers.answer import StudyAnswer
from pneuma.errors import Hint, UserError


def profile_scores(data: StudyData) -> StudyAnswer:
    """Return the share of runs above each score, over all environments together.

    Returns:
        The table `profiles` has condition, x, share, low, high and runs.

    Raises:
        UserError: for a study of one environment, or scores without a scale.
    """
    data_by_env = by_environment(data)
    if len(data_by_env) == 1:
        raise UserError(
            Hint("figure", "profile"), f": is over several environments; {data.study.name} has one"
        )
    table = profiles(data_by_env)
    scales: list[str] = []
    for env, (low, high) in references(data_by_env).items():
        scale = f"{low:.3g} and {high:.3g}".replace("-", "−") + f" in {env}"
        if env not in data.study.scores:
            scale += " (random player, best condition)"
        scales.append(scale)
    notes = [f"Score: {find_outcome(OUTCOME).words}; 0 and 1 are {', '.join(scales)}.", data.ends]
    cells = table[["condition", "runs"]].drop_duplicates()
    return StudyAnswer(data.full_title, data.about, {"profiles": table}, [cells], notes, data=data)
