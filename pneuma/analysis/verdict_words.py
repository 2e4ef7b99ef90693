"""Verdicts in plain words: the thesis's sentence, a word for each world, and the effect in plain units.

    [Verdict] → `verdict_table`, which pages, pictures, the report and `pneuma study verify` print alike

`docs/claims.md` says how the words come from what the judge decides.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from textwrap import shorten

import pandas as pd

from pneuma.analysis.claim_table import ClaimContrast
from pneuma.analysis.claims import MINUS, Arms, Claim
from pneuma.analysis.intervals import MOST, decimals, shown
from pneuma.analysis.judgement import (
    INCONCLUSIVE,
    MIXED,
    REFUTED,
    SUPPORTED,
    UNTESTABLE,
    Verdict,
)
from pneuma.analysis.outcomes import find_outcome
from pneuma.worlds import WORLDS

HOLDS, FAILS, UNDECIDED, NOT_TESTED = "holds", "does not hold", "undecided", "not tested"
WORDS = {
    HOLDS: "The runs show what the sentence says.",
    FAILS: "They show the opposite, or that the difference is too small to count.",
    UNDECIDED: "They show neither; or of two measures one speaks for the sentence and one against it.",
    NOT_TESTED: "The runs are not there yet, or cannot tell anything about it.",
}
"""The four words, and what each says of a sentence in a world."""
_WORD_OF = {
    SUPPORTED: HOLDS, REFUTED: FAILS, MIXED: UNDECIDED, INCONCLUSIVE: UNDECIDED, UNTESTABLE: NOT_TESTED,
}  # fmt: skip

WORLD_NAMES = {
    name: world.title.removeprefix("the ").removesuffix("'s world") for name, world in WORLDS.items()
}
"""Heads of columns: text, published code, arena."""

_PLAIN_REASONS = {
    "not admitted": "too few runs",
    "too few seeds": "too few runs",
    "arm at floor": "the agents learned nothing there",
    "arms at floor": "the agents learned nothing there",
    "both arms are at the floor": "all runs end alike",
    "both arms are at the ceiling": "all runs end alike",
    "A/A": "what is compared is the same",
    "engines are mixed": "trained by different engines",
}
"""The beginnings of the judge's reasons, where they need a glossary."""

_SAID = {
    "final-return": "return",
    "auc-return": "return over training",
    "final-share-killed": "kills",
    "late-share-killed": "kills",
    "auc-share-killed": "kills over training",
    "late-slope": "late rise of kills",
    "fall-from-best": "fall from the best",
    "curve-roughness": "roughness",
    "stuck-share": "updates with one action",
    "mean-kl": "change of policy (KL)",
    "final-died": "deaths",
    "final-hp": "HP left",
    "final-action-4": "strikes",
    "grad-norm-growth": "gradient norm, end over beginning",
    "log-max-grad-norm": "greatest gradient norm",
    "one-action above 0.9": "runs with one action",
    "collapsed above 0.5": "runs that collapse",
}
"""Outcomes in fewer words than `OUTCOMES` has."""
_OF_KIND = {"spread": "spread of {}", "range": "range of {}"}
MOST_LOG = 23.0
"""Factors above ten thousand million are told as infinite."""
_LOGARITHMS = ("grad-norm-growth", "log-max-grad-norm")


def verdicts_by_claim(verdicts: Iterable[Verdict]) -> dict[str, dict[str, Verdict]]:
    """Return verdicts by claim and world, the claims in the order of the thesis's sections."""
    grouped: dict[str, dict[str, Verdict]] = {}
    for one in sorted(verdicts, key=lambda one: [*map(int, re.findall(r"\d+", one.claim.section))]):
        grouped.setdefault(one.claim.name, {})[one.world] = one
    return grouped


def worlds_of(claims: Mapping[str, Mapping[str, Verdict]]) -> list[str]:
    judged = {world for worlds in claims.values() for world in worlds}
    return [world for world in WORLDS if world in judged]


def count_words(claims: Mapping[str, Mapping[str, Verdict]]) -> pd.DataFrame:
    """Return how many claims have each word, a row for each world."""
    rows = []
    for world in worlds_of(claims):
        counts = Counter(word(worlds[world]) for worlds in claims.values() if world in worlds)
        rows.append([WORLD_NAMES[world], *(counts[each] for each in WORDS)])
    return pd.DataFrame(rows, columns=["", *WORDS])


def verdict_table(claims: Mapping[str, Mapping[str, Verdict]], whole: bool = False) -> pd.DataFrame:
    """Return a row for each claim: section, sentence, and for each world the word with the effect below it.

    With `whole`, sentences are not shortened.
    """
    columns, rows, quoted = worlds_of(claims), [], set()
    for judged in claims.values():
        claim = next(iter(judged.values())).claim
        text = f"“{sentence(claim) if whole else short_sentence(claim)}”"
        told = claim.context if text in quoted and claim.context else text
        quoted.add(text)
        rows.append([claim.section, told, *(cell(judged.get(world)) for world in columns)])
    heads = ["Section", "The thesis's sentence", *(WORLD_NAMES[world] for world in columns)]
    return pd.DataFrame(rows, columns=heads)


def cell(verdict: Verdict | None) -> str:
    """Return a verdict's word, and in the next line its effect, or why there is none."""
    return "–" if verdict is None else "\n".join(filter(None, (word(verdict), told(verdict))))


# --- One verdict -----------------------------------------------------------------------------------


def word(verdict: Verdict) -> str:
    return _WORD_OF[verdict.verdict]


def told(verdict: Verdict) -> str:
    """Return the effect that decides, if any was tested, and what must be said beside it or in its place."""
    row = verdict.decisive
    tested = row and row.has_effect and word(verdict) != NOT_TESTED
    return "; ".join(filter(None, (effect(row) if row and tested else "", why(verdict))))


def why(verdict: Verdict) -> str:
    """Return in a few words why a claim is not tested, or what its word does not say; mostly empty."""
    if verdict.lacks_runs:
        return "partly trained" if verdict.run_ids else "not trained yet"
    if verdict.verdict == MIXED:
        return "its two measures disagree"
    reason = verdict.reason.partition(":")[0]
    return "a run has no value" if " seed " in reason else _PLAIN_REASONS.get(reason, reason)


def effect(row: ClaimContrast) -> str:
    """Return an effect in plain units, as 'kills: tanh 85 %, relu 83 %; +2 points (−1 to 5)'.

    It is the first less the second. The interval is the one that holds together with all others of the world.
    """
    contrast, alone = row.contrast, not row.b and row.value == 0
    numbers = [*contrast.means, contrast.effect, contrast.simultaneous.low, contrast.simultaneous.high]
    unit = difference = ""
    if row.outcome in _LOGARITHMS and row.claim.kind == "mean":
        a, b, size, low, high = (_factor(number) for number in numbers)
        difference = " times as much"
    else:
        if row.claim.event or find_outcome(row.outcome.split(MINUS)[0]).unit == "share":
            numbers, unit, difference = [100 * number for number in numbers], " %", " points"
        places = _places(*numbers[2:])
        a, b, size, low, high = (shown(number, places).replace("-", "−") for number in numbers)
        size = size if alone or size.startswith("−") or not size.strip("0.") else f"+{size}"
    between = f" ({low} to {high})" if contrast.simultaneous.exists else ""
    if alone:
        return f"{_said(row)}: {_arm(row.a)} {size}{unit}{between}"
    other = _arm(row.b) if row.b else "threshold"
    return f"{_said(row)}: {_arm(row.a)} {a}{unit}, {other} {b}{unit}; {size}{difference}{between}"


def _arm(conditions: Arms) -> str:
    return " and ".join(filter(None, (", ".join(conditions[:-1]), conditions[-1])))


def _said(row: ClaimContrast) -> str:
    named = f"{row.outcome} {row.claim.event}".strip()
    words = _SAID.get(named) or " less ".join(
        _SAID.get(part, find_outcome(part).words) for part in row.outcome.split(MINUS)
    )
    if row.claim.event and named not in _SAID:
        words = f"runs with {words} {row.claim.event}"
    return _OF_KIND.get(row.claim.kind, "{}").format(words)


def _places(size: float, low: float, high: float) -> int:
    """Return decimal places by which half an interval has one digit, or two if it begins with 1."""
    half = (high - low) / 2
    if not half > 0:
        return decimals(size)
    places = min(MOST, -math.floor(math.log10(half / 2)))
    return places + (round(size, places) == 0)


def _factor(log: float) -> str:
    """Return a factor with two digits, given its logarithm."""
    if log > MOST_LOG:
        return "∞"
    factor = math.exp(log)
    return shown(factor, decimals(factor) - 1)


# --- Sentences -------------------------------------------------------------------------------------


def sentence(claim: Claim) -> str:
    """Return the thesis's sentence without the marks of TeX and Markdown."""
    text = re.sub(r"\$\$.*?\$\$ *|_\{[^}]*\}|[*$]|\[\d+\]", "", claim.quote)
    text = re.sub(r"\\([a-z]+|\|) ?", lambda found: _SYMBOLS.get(found[1], found[1]), text)
    text = re.sub(r"_(\w)", lambda found: found[1].translate(_SUBSCRIPTS), text)
    return re.sub(r" (?=[,.;)])", "", " ".join(text.split()))


def short_sentence(claim: Claim) -> str:
    """Return the sentence with … where words are left out."""
    return _SHORT.get(claim.name) or shorten(sentence(claim), LONGEST_SENTENCE, placeholder=" …")


LONGEST_SENTENCE = 160
_SUBSCRIPTS = str.maketrans("012t", "₀₁₂ₜ")
_SYMBOLS = {"tanh": "tanh ", "beta": "β", "nabla": "∇", "vartheta": "ϑ", "leq": "≤ ", "|": "‖"}

_SHORT = {
    "tanh-better": "We see that tanh … improves performance",
    "tanh-steadier": "We see that tanh … decreases variance",
    "betas-better": "… the non-stationary Adam greatly outperforms the default configuration",
    "betas-steadier": "Notice how the variance of the non-stationary Adam version is smaller",
    "small-best": "The small network has the best overall performance",
    "small-steadiest": "The small network has … the lowest variance",
    "actor-loses-nothing": (
        "Letting the actor’s network size remain small … whilst having the critic’s network be "
        "significantly bigger … seemed to have little to no effect"
    ),
    "default-adam-collapses": (
        "… the bad choice caused the agents to steadily improve up to a point, upon which they completely "
        "collapsed …, or even worse to converge to a single-action optimum"
    ),
    "early-one-action": (
        "… we run into many cases where the agent(s) would collapse into a single repetitive action"
    ),
    "betas-solve": (
        "… we used a non-stationary Adam optimizer, where β₁ = β₂ = 0.9, … which seems to effectively "
        "solve the issue"
    ),
    "sgd-sensitive": (
        "… SGD has several limitations, with the most important being a sensitivity to changes of the "
        "learning rate"
    ),
    "relu-explodes": "… we run into issues with exploding gradient norms",
    "relu-never-converges": "… which … caused the agent to oscillate, and ultimately never converge",
    "leaky-helps": (
        "Although this helped reduce the problem, it did not completely eliminate it, and so we settled "
        "with the tanh function"
    ),
    "ppo-sensitive": (
        "Proximal Policy Optimization … can be very sensitive to hyperparameter changes, with … overall "
        "performance fluctuating greatly"
    ),
    "horizon-faster": (
        "The horizon was reduced from 2048 to 256, so that the networks … respond and adapt faster"
    ),
    "magic-no-benefit": "This … increased the complexity for no noticeable benefit",
    "sigmoid-frenzy": (
        "… a structure where the agent has to maintain a short distance to the enemies using a sigmoid "
        "function, resulted in … a suicidal frenzy"
    ),
    "reward-balances": (
        "The reward function therefore pushes the agent to try to strike a balance between combating "
        "enemies … whilst trying to maintain some distance"
    ),
    "classes-differ": (
        '… predefined classes, such as "tank", "mage", and "warrior", which encourage agents to tackle '
        "their assigned objectives using different approaches"
    ),
}
"""The words of a shipped claim's sentence that say what it tests, where others can be left out."""
