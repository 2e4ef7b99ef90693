"""How much each hyperparameter matters: PED-ANOVA over a search's complete trials.

Watanabe, Bansal and Hutter (2023): it compares where the best trials lie, along each parameter, with where
all of them lie. The best are a tenth, but never fewer than five.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from typing import Any

from pneuma.search.record import trial_values
from pneuma.search.space import Space

LEAST_TRIALS = 10
"""Below this many complete trials there is no telling."""
BEST_TRIALS = 5
BEST_SHARE = 0.1


def importances(record: Mapping[str, Any], space: Space) -> dict[str, float]:
    """Return the importance of every parameter that all complete trials have, summing to 1.

    Of several objectives, that for the first. Empty with fewer than `LEAST_TRIALS` complete trials, or
    where no best ones can be told from the others: too many of them share the worst value.
    """
    import optuna
    from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances

    from pneuma.search.sampling import distributions

    complete = [trial for trial in record["trials"] if trial["state"] == "complete"]
    values = [trial_values(trial)[0] for trial in complete]
    best_share = max(BEST_SHARE, BEST_TRIALS / max(len(complete), 1))
    direction = record["identity"]["objectives"][0]["direction"]
    ordered = sorted(values, reverse=direction == "maximize")
    if len(complete) < LEAST_TRIALS or ordered[math.ceil(best_share * len(complete)) - 1] == ordered[-1]:
        return {}
    study = optuna.create_study(storage=optuna.storages.InMemoryStorage(), direction=direction)
    for trial, value in zip(complete, values, strict=True):
        study.add_trial(
            optuna.trial.create_trial(
                value=value, params=trial["params"], distributions=distributions(space, trial["params"])
            )
        )
    shared = [p.name for p in space.parameters if all(p.name in trial["params"] for trial in complete)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        evaluator = PedAnovaImportanceEvaluator(
            target_quantile=best_share,
            region_quantile=1.0,
            evaluate_on_local=True,
        )
        found = get_param_importances(study, evaluator=evaluator, params=shared, normalize=True)
    return {name: float(value) for name, value in found.items()}
