"""Print how kills go with the learning rate over the samples of an update, for the study `noise-scale`.

    python studies/noise_scale.py RESULTS

Each row is one condition, by falling ratio; the last line is Spearman's correlation over conditions.
"""

from __future__ import annotations

import sys

import numpy as np
from scipy.stats import spearmanr

from pneuma.analysis.asked import open_study
from pneuma.analysis.outcomes import outcome_values
from pneuma.analysis.run_index import RunIndex
from pneuma.study.plan import Selection
from pneuma.study.store import Store

if __name__ == "__main__":
    data = open_study(RunIndex(Store(sys.argv[1])), "noise-scale", Selection(steps=294_912))
    rows = []
    for name in data.conditions:
        if runs := data.of_condition(name):
            slots, horizon, rate = (runs[0].fields[key] for key in ("slots", "horizon", "learning_rate"))
            killed = float(np.mean(outcome_values(data, name, "late-share-killed")))
            rows.append((rate / (slots * horizon), slots, horizon, rate, len(runs), killed))
    rows.sort(reverse=True)
    print("ratio     slots  horizon  rate    runs  killed")
    for ratio, slots, horizon, rate, count, killed in rows:
        print(f"{ratio:.1e}  {slots:5}  {horizon:7}  {rate:.0e}  {count:5}  {killed:.2f}")
    ratios, kills = [row[0] for row in rows], [row[-1] for row in rows]
    print(f"Spearman's correlation of {len(rows)} conditions: {spearmanr(ratios, kills).statistic:.2f}")
