"""The runs of claims by another hand: which published runs a condition means, and what each run comes to.

    studies/STUDY.toml and a world → the fields of a condition → the published runs that have them
    a run's row → outcomes, from evaluations and curves

Nothing of Pneuma is imported. A field that neither a study nor its base sets is what most published runs have
in the environment and by the optimizer.
"""

from __future__ import annotations

import json
import tomllib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from scipy import stats

ROOT = Path(__file__).parents[1]
PUBLISHED = ROOT / "results" / "published"
SLACK = 0.025
"""A run may be so much longer than was claimed, as it ends with a whole update."""

Row = dict[str, Any]
Fields = Mapping[str, Any]

# --- Conditions --------------------------------------------------------------------------------------

BOTH_TABLES: Fields = {
    "gamma": 0.99, "gae_lambda": 0.95, "learning_rate": 3e-4, "minibatch": 64, "entropy_coefficient": 0.01,
    "optimizer": "adam", "actor": [128], "critic": [256],
}  # fmt: skip
TABLES: Mapping[str, Fields] = {
    "table-6-1": {
        **BOTH_TABLES, "clip_range": 0.2, "horizon": 2048, "epochs": 15, "value_coefficient": 1.0,
        "betas": [0.9, 0.999], "activation": "relu", "gradient_limit": None,
    },
    "table-6-2": {
        **BOTH_TABLES, "clip_range": 0.1, "horizon": 256, "epochs": 10, "value_coefficient": 0.5,
        "betas": [0.9, 0.9], "activation": "tanh", "gradient_limit": 0.5,
    },
}  # fmt: skip
"""The thesis's Tables 6.1 and 6.2."""
ENVIRONMENTS = {"text": "Pneuma-v0", "arena": "PneumaArena-v0", "godot": "PneumaGodot-v0"}
OF_GAME: Fields = {"clip_range": 0.2, "actor": [256]}
"""What the published code has instead of the tables, where a study says nothing."""


@cache
def read_study(name: str) -> Mapping[str, Any]:
    return tomllib.loads((ROOT / "studies" / f"{name}.toml").read_text(encoding="utf-8"))


def fields_of(study: str, condition: str, world: str) -> dict[str, Any]:
    """Return the fields of a condition that its base, its study or its world sets."""
    file = read_study(study)
    conditions: dict[str, Fields] = file.get("conditions", {})
    if "factors" in file:
        parts: list[dict[str, Fields]] = []
        for factor, values in file["factors"].items():
            named = values if isinstance(values, dict) else {f"{factor}={v}": {factor: v} for v in values}
            parts.append(named)
        parts += [dict(conditions)] if conditions else []
        conditions = {}
        for names in product(*parts):
            crossed: dict[str, Any] = {}
            for part, name in zip(parts, names, strict=True):
                crossed |= part[name]
            conditions[", ".join(names)] = crossed
    run = dict(file.get("run", {}))
    set_by_study = {*run, *(key for fields in conditions.values() for key in fields)}
    base = dict(TABLES[file["base"]])
    if world == "godot":
        base |= {key: value for key, value in OF_GAME.items() if key not in set_by_study}
    own = {**run, **conditions[condition], "env": f"pneuma/{ENVIRONMENTS[world]}"}
    return {key: plain(value) for key, value in {**base, **own}.items()}


def plain(value: Any) -> Any:
    """Return a value as stored fields have it: a list of one as that one, "none" as null."""
    if isinstance(value, list) and len(value) == 1 and isinstance(value[0], str):
        return plain(value[0])
    return None if value == "none" else value


READ = {
    "run_id", "provenance", "seed", "steps", "end", "fields", "signs", "evaluations", "return last",
    "hp last", "kills budget-5%",
    "explained_variance early", "grad_norm", "approx_kl peak", "approx_kl extreme",
    *(f"action_{place} last" for place in range(5)),
}  # fmt: skip
"""The columns that outcomes are taken from."""


class Runs:
    """All published runs in Pneuma's worlds."""

    def __init__(self, folder: Path = PUBLISHED) -> None:
        self.rows: dict[str, Row] = {}
        self._known: dict[tuple[str, str, str], list[Row]] = {}
        for path in sorted(folder.glob("*.parquet")):
            columns = {*pq.read_schema(path).names} & READ
            for row in pq.read_table(path, columns=sorted(columns)).to_pylist():
                fields = {key: plain(value) for key, value in json.loads(row["fields"]).items()}
                if str(fields.get("env")).removeprefix("pneuma/") in ENVIRONMENTS.values():
                    self.rows.setdefault(row["run_id"], {**row, "fields": fields})
        counts: dict[tuple[Any, ...], Counter[str]] = {}
        for row in self.rows.values():
            fields = row["fields"]
            for key, value in fields.items():
                place = fields["env"], fields["optimizer"], key
                counts.setdefault(place, Counter())[json.dumps(value)] += 1
        self.usual = {place: json.loads(count.most_common(1)[0][0]) for place, count in counts.items()}

    def of_condition(self, study: str, condition: str, world: str) -> list[Row]:
        """Return all runs of a condition, of any seed and budget."""
        key = study, condition, world
        if key not in self._known:
            fields = fields_of(study, condition, world)
            self._known[key] = [row for row in self.rows.values() if self.has_fields(row["fields"], fields)]
        return self._known[key]

    def has_fields(self, stored: Fields, fields: Fields) -> bool:
        """Return whether a stored run has some fields; SGD has no betas, which the tables set."""
        if stored["env"] != fields["env"] or stored["optimizer"] != fields["optimizer"]:
            return False
        for key, value in stored.items():
            if key in ("seed", "steps") or (key == "betas" and value is None):
                continue
            usual = self.usual[stored["env"], stored["optimizer"], key]
            if value != fields.get(key, usual):
                return False
        return True


def fixed(rows: Sequence[Row], seeds: Sequence[int], steps: int) -> list[Row]:
    """Return the runs of some seeds and steps, seed by seed: of a seed the one that was trained first."""
    chosen: dict[int, Row] = {}
    for row in sorted(rows, key=lambda row: str(json.loads(row["provenance"]).get("started"))):
        if row["seed"] in seeds and steps <= row["steps"] < steps * (1 + SLACK):
            chosen.setdefault(row["seed"], row)
    return [chosen[seed] for seed in sorted(chosen)]


# --- Outcomes ----------------------------------------------------------------------------------------


def evaluations(run: Row, column: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps and the values of a column, where it has one, up to the run's budget."""
    known = [(each["step"], each[column]) for each in run["evaluations"] if each.get(column) is not None]
    steps, values = np.array(known, float).reshape(-1, 2).T
    keep = np.isfinite(values) & (steps <= run["steps"] * (1 + SLACK))
    return steps[keep], values[keep]


def points(run: Row, column: str) -> np.ndarray:
    """Return the points of a curve that have a value."""
    values = np.array(run.get(column) or [], float)
    return values[np.isfinite(values)]


def at_end(quantity: str, statistic: str) -> Callable[[Row], float]:
    return lambda run: np.nan if (value := run.get(f"{quantity} {statistic}")) is None else value


def last_of(column: str) -> Callable[[Row], float]:
    return lambda run: float(evaluations(run, column)[1][-1])


def roughness(run: Row) -> float:
    killed = evaluations(run, "share_killed")[1]
    ups_and_downs = sum(abs(after - before) for before, after in zip(killed, killed[1:], strict=False))
    return (ups_and_downs - abs(killed[-1] - killed[0])) / (len(killed) - 1)


def best_five(killed: np.ndarray) -> float:
    return float(np.mean(sorted(killed, reverse=True)[:5]))


def late_fall(run: Row) -> float:
    killed = evaluations(run, "share_killed")[1]
    return best_five(killed) - float(np.mean(killed[-5:]))


def shuffled_fall(run: Row) -> float:
    """Return the mean of `late_fall` over all orders: on average the last five have the mean of all."""
    killed = evaluations(run, "share_killed")[1]
    return best_five(killed) - float(np.mean(killed))


def one_action_time(run: Row) -> float:
    shares = evaluations(run, "commonest_action")[1][-5:]
    return sum(share > 0.9 for share in shares) / len(shares)


def lasting_one_action(run: Row) -> float:
    """Return the step from which five evaluations in a row are in one action; infinite if none are."""
    steps, shares = evaluations(run, "commonest_action")
    in_a_row = 0
    for place, share in enumerate(shares):
        in_a_row = in_a_row + 1 if share > 0.9 else 0
        if in_a_row == 5:
            return float(steps[place - 4])
    return float("inf")


def growth(run: Row) -> float:
    norms = [max(norm, 1e-8) for norm in points(run, "grad_norm")]
    tenth = max(len(norms) // 10, 1)
    return float(np.mean(np.log(norms[-tenth:])) - np.mean(np.log(norms[:tenth])))


def log_max_kl(run: Row) -> float:
    exact = run.get("approx_kl peak")
    most = max(points(run, "approx_kl extreme"), default=np.nan) if exact is None else exact
    return float(np.log(max(most, 1e-8)))


def stretches(run: Row, sign: str) -> tuple[int, list[list[int]]]:
    """Return the steps of an update, and from where to where a sign holds; gaps and lengths alternate."""
    packed, fields = json.loads(run["signs"]), run["fields"]
    ends = (packed["unit"] * np.cumsum([0, *packed["signs"][sign]])[1:]).reshape(-1, 2).tolist()
    return fields["horizon"] * fields["slots"] * fields["players"], ends


def low_entropy(run: Row) -> float:
    """Return the share of training in stretches of updates without entropy."""
    update, ends = stretches(run, "no entropy")
    return sum(min(last, run["end"]) + update - first for first, last in ends) / run["end"]


def late_updates(run: Row) -> float:
    """Return the share of the updates in one action that end in the last quarter of the budget."""
    update, ends = stretches(run, "one action")
    late = [step for step in range(update, run["end"] + 1, update) if step > run["end"] - run["steps"] / 4]
    return float(np.mean([any(first <= step <= last for first, last in ends) for step in late]))


def lasting_spell(run: Row) -> float:
    """Return the step of the first stretch in one action of a twentieth of the budget, or infinity."""
    update, ends = stretches(run, "one action")
    return min((first for first, last in ends if last - first + update >= run["steps"] / 20), default=np.inf)


def one_action(run: Row) -> float:
    shares = [run[f"action_{place} last"] for place in range(5)]
    return float(max([*shares, 1 - sum(shares)]))


def steps_to(run: Row, least: float) -> float:
    """Return the step at which lines from evaluation to evaluation kill so much; the budget if none does."""
    before: tuple[float, float] | None = None
    for step, share in zip(*evaluations(run, "share_killed"), strict=True):
        if share >= least:
            return float(step if before is None else np.interp(least, (before[1], share), (before[0], step)))
        before = step, share
    return float(run["steps"])


def steps_to_evaluation(run: Row, least: float) -> float:
    """Return the step of the first evaluation that kills so much, as before version 6 of the rules."""
    reached = [step for step, share in zip(*evaluations(run, "share_killed"), strict=True) if share >= least]
    return float(min(reached, default=run["steps"]))


OUTCOMES: dict[str, Callable[[Row], float]] = {
    "final-return": at_end("return", "last"),
    "final-hp": at_end("hp", "last"),
    "final-action-4": at_end("action_4", "last"),
    "early-explained-variance": at_end("explained_variance", "early"),
    "final-died": last_of("died"),
    "late-share-killed": lambda run: float(np.mean(evaluations(run, "share_killed")[1][-5:])),
    "late-fall": late_fall,
    "shuffled-fall": shuffled_fall,
    "late-one-action-time": one_action_time,
    "lasting-one-action-step": lasting_one_action,
    "late-one-action-updates": late_updates,
    "lasting-one-action-spell": lasting_spell,
    "final-kills": lambda run: float(points(run, "kills budget-5%")[-1]),
    "curve-roughness": roughness,
    "grad-norm-growth": growth,
    "log-max-kl": log_max_kl,
    "low-entropy-share": low_entropy,
    "one-action": one_action,
}
HIGHER = {"final-return", "final-hp", "final-kills", "early-explained-variance", "late-share-killed"}
"""Outcomes of play: those of which more is better."""
LOWER = {
    "final-died", "late-fall", "late-one-action-time", "curve-roughness", "grad-norm-growth",
    "late-one-action-updates", "low-entropy-share",
}  # fmt: skip
OF_LEARNERS = {"curve-roughness", "late-fall"}
"""Outcomes that mean nothing where nothing was learned; before version 6 of the rules the first alone."""
SHARES = {"late-share-killed", "final-action-4", "one-action", *LOWER} - {"grad-norm-growth"}


def value_of(run: Row, outcome: str, is_before: bool = False) -> float:
    if outcome.startswith("steps-to:"):
        least = float(outcome.removeprefix("steps-to:"))
        return steps_to_evaluation(run, least) if is_before else steps_to(run, least)
    return OUTCOMES[outcome](run)


def learned(runs: Sequence[Row]) -> bool:
    """Return whether runs are shown to beat the random player, of score 0, at 5 % to one side."""
    scores = [float(np.mean(evaluations(run, "score")[1])) for run in runs]
    if np.ptp(scores) == 0:
        return scores[0] > 0
    return bool(stats.ttest_1samp(scores, 0, alternative="greater").pvalue < 0.05)
