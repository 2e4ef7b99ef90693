"""A user's script, whose types `mypy --strict` checks: it trains, compares, plots and loads a policy."""

from __future__ import annotations

import matplotlib.pyplot as plt
import pandas as pd
from stable_baselines3.common.type_aliases import PolicyPredictor

from pneuma.api import compare, load_policy, open_data, plot, run_study, summarize

trained = run_study("activation", seeds=2, steps=1_024, conditions=["tanh", "relu"], quiet=True)
data = open_data("activation", preset="paper")
comparison = compare(data, "tanh", "relu", ["final-return"])
rows: pd.DataFrame = comparison.table
print(comparison.title, *comparison.notes, rows["difference"].iloc[0])
print(summarize(data, ["final-share-killed"]).table)

figure, axes = plt.subplots()
plot(data, "return", ax=axes, band="ci").set_title("Returns")
figure.savefig("returns.png")

policy, env_id, settings = load_policy(str(trained.runs["run_id"].iloc[0]))
predictor: PolicyPredictor = policy
print(env_id, settings, predictor.predict(trained.grid, deterministic=True)[0])
