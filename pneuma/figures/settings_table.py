"""Thesis Tables 6.1 and 6.2 as they are here: the two bases of every study, resolved, side by side."""

from __future__ import annotations

import pandas as pd

from pneuma.config import BASES, as_fields, make_run
from pneuma.values import shown_value

SETTINGS = (
    "gamma", "gae_lambda", "learning_rate", "clip_range", "horizon", "minibatch", "epochs",
    "value_coefficient", "entropy_coefficient", "optimizer", "betas", "epsilon", "activation",
    "gradient_limit", "actor", "critic",
)  # fmt: skip
"""What the tables state, or leave to the library."""


def settings_table() -> pd.DataFrame:
    """Return a row for each setting: its name, its value in either table, whether they differ."""
    bases = [as_fields(make_run(settings)) for settings in BASES.values()]
    rows = [[name, *(shown_value(base[name]) for base in bases)] for name in SETTINGS]
    table = pd.DataFrame(rows, columns=["setting", *BASES])
    table["differs"] = ["yes" if one != other else "" for _, one, other in rows]
    return table
