"""Performance profiles of a study of several environments (Agarwal et al. 2021)."""

from __future__ import annotations

from pneuma.analysis.answer import StudyAnswer
from pneuma.analysis.environments import OUTCOME, by_environment, profiles, references
from pneuma.analysis.notes import notes_on_ends
from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.study_data import StudyData
from pneuma.errors import Hint, UserError


def profile_scores(study_data: StudyData) -> StudyAnswer:
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
    return StudyAnswer(
        study_data.full_title,
        study_data.about,
        {"profiles": profile_table},
        [cells],
        [scale_note] + notes_on_ends(study_data),
        data=study_data,
    )
