"""Verdicts in plain words: the thesis's sentence, a word for each world, and the effect in plain units.

    [Verdict] → `verdict_table`, which pages, pictures, the report and `pneuma study verify` print alike

`docs/claims.md` explains how the words come from what the judge decides.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from textwrap import shorten

import pandas as pd

from pneuma.analysis.claims.claim_list import TOGETHER, Claim
from pneuma.analysis.claims.verdicts import (
    DESCRIBED,
    DESCRIPTIVE,
    INCONCLUSIVE,
    MIXED,
    PREREGISTERED,
    REFUTED,
    SUPPORTED,
    UNTESTABLE,
    ClaimContrast,
    Verdict,
)
from pneuma.analysis.intervals import MOST, decimals, shown
from pneuma.analysis.outcomes import find_outcome
from pneuma.presets import WORLDS

HOLDS, FAILS, UNDECIDED, NOT_TESTED = "holds", "does not hold", "undecided", "not tested"
WORDS = {
    HOLDS: "The runs show what the sentence says.",
    FAILS: "They show the opposite, or that the difference is too small to count.",
    UNDECIDED: "They show neither; or of two measures one speaks for the sentence and one against it.",
    NOT_TESTED: "The runs are not there yet, or cannot tell anything about it.",
}
"""The four words, and what each says of a sentence in a world."""
_LETTERS = {PREREGISTERED: "p", DESCRIPTIVE: "d"}
_WORD_OF = {
    SUPPORTED: HOLDS, REFUTED: FAILS, MIXED: UNDECIDED, INCONCLUSIVE: UNDECIDED, UNTESTABLE: NOT_TESTED,
    DESCRIBED: DESCRIBED,
}  # fmt: skip

WORLD_NAMES = {
    name: world.title.removeprefix("the ").removesuffix("'s world") for name, world in WORLDS.items()
}
"""Heads of columns: text, published code, arena."""

_PLAIN_REASONS = {
    "arm at floor": "the agents learned nothing there",
    "both arms are at the floor": "all runs end alike",
    "both arms are at the ceiling": "all runs end alike",
    "A/A": "what is compared is the same",
    "engines are mixed": "trained by different engines",
}
"""The beginnings of the judge's reasons, where they need a glossary."""

_OUTCOME_NAMES = {
    "final-return": "return",
    "auc-return": "return over training",
    "final-share-killed": "kills",
    "late-share-killed": "kills",
    "auc-share-killed": "kills over training",
    "late-one-action-time": "time in one action",
    "lasting-one-action-step": "runs that come to stay in one action",
    "late-slope": "late rise of kills",
    "fall-from-best": "fall from the best",
    "late-fall": "fall from the best five evaluations",
    "shuffled-fall": "in random order",
    "curve-roughness": "roughness",
    "stuck-share": "updates with one action",
    "mean-kl": "change of policy (KL)",
    "final-died": "deaths",
    "final-hp": "HP left",
    "final-action-4": "strikes",
    "grad-norm-growth": "gradient norm, end over beginning",
    "log-max-grad-norm": "greatest gradient norm",
    "one-action above 0.9": "runs with one action",
    "low-entropy-share": "training without entropy",
    "log-max-kl": "largest change of policy (KL)",
    "early-explained-variance": "variance that the critic explains at first",
}
"""Outcomes and events in fewer words than `OUTCOMES` has."""
MOST_LOG = 23.0
"""Factors above ten thousand million are shown as infinite."""
_LOGARITHMS = ("grad-norm-growth", "log-max-grad-norm", "log-max-kl")

LONGEST_SENTENCE = 160
_SUBSCRIPTS = str.maketrans("012t", "₀₁₂ₜ")
_SYMBOLS = {"tanh": "tanh ", "beta": "β", "nabla": "∇", "vartheta": "ϑ", "leq": "≤ ", "|": "‖"}

ByClaim = Mapping[str, Mapping[str, Verdict]]
"""Verdicts by claim and world."""


def verdicts_by_claim(verdicts: Iterable[Verdict]) -> dict[str, dict[str, Verdict]]:
    """Return verdicts by claim and world, the claims in the order of the thesis's sections.

    Those of a claim that is like another stand with the other's.
    """
    by_claim: dict[str, dict[str, Verdict]] = {}
    for verdict in sorted(verdicts, key=_section_numbers):
        by_claim.setdefault(verdict.claim.row, {})[verdict.world] = verdict
    return by_claim


def _section_numbers(verdict: Verdict) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", verdict.claim.section)]


def first_claim(name: str, by_world: Mapping[str, Verdict]) -> Claim:
    """Return the claim of a row: the one that others are like, or the first of these without it."""
    claims = {verdict.claim.name: verdict.claim for verdict in by_world.values()}
    return claims.get(name) or next(iter(claims.values()))


def worlds_of(by_claim: ByClaim) -> dict[str, str]:
    """Return the names of the worlds in which claims were judged; statements of one's own may have none."""
    worlds: set[str] = set()
    has_quotes = False
    for by_world in by_claim.values():
        for world, verdict in by_world.items():
            worlds.add(world)
            has_quotes |= bool(verdict.claim.quote)
    if len(worlds) == 1 and not has_quotes:
        return dict.fromkeys(worlds, "verdict")
    return {world: name for world, name in WORLD_NAMES.items() if world in worlds}


def count_words(by_claim: ByClaim) -> pd.DataFrame:
    """Return how many claims have each word, a row for each world."""
    counts: dict[str, Counter[str]] = {}
    for by_world in by_claim.values():
        for world, verdict in by_world.items():
            counts.setdefault(world, Counter()).update([word(verdict)])
    rows = []
    for world, name in worlds_of(by_claim).items():
        rows.append([name] + [counts[world][each_word] for each_word in WORDS])
    return pd.DataFrame(rows, columns=["", *WORDS])


def verdict_table(by_claim: ByClaim, whole: bool = False) -> pd.DataFrame:
    """Return a row for each claim: section, sentence and arms, and for each world the word and effects.

    With `whole`, sentences are not shortened.
    """
    worlds = worlds_of(by_claim)
    rows: list[list[str]] = []
    quoted: set[str] = set()
    for name, by_world in by_claim.items():
        claim = first_claim(name, by_world)
        quote = sentence(claim) if whole else short_sentence(claim)
        if quote and quote not in quoted:
            heading = f"“{quote}”"
            quoted.add(quote)
        else:
            heading = claim.context or name
        row = [claim.section, f"{heading}\n{arms_in_words(claim)}"]
        for world in worlds:
            row.append(cell(by_world[world]) if world in by_world else "–")
        rows.append(row)
    heading = "The thesis's sentence" if quoted else "Claim"
    return pd.DataFrame(rows, columns=["Section", heading, *worlds.values()])


# --- One verdict -----------------------------------------------------------------------------------


def cell(verdict: Verdict) -> str:
    """Return a verdict's word and label; in the next lines its effects, or why there are none."""
    return "\n".join([f"{word(verdict)} [{letter(verdict)}]", *lines(verdict)])


def word(verdict: Verdict) -> str:
    return _WORD_OF[verdict.verdict]


def lines(verdict: Verdict) -> list[str]:
    """Return the effect of each outcome, if any was tested, and what must be added or stands instead."""
    texts: list[str] = []
    if word(verdict) != NOT_TESTED:
        tested = [row for row in verdict.deciding if row.has_effect]
        texts = [effect(row) for row in tested]
        if any(row.none_learned for row in tested):
            texts.append("none plays better than at random")
        for row in tested[:1]:
            runs, other_runs = row.contrast.seeds
            if other_runs and runs != other_runs:
                texts.append(f"{runs} against {other_runs} runs")
    reason = why(verdict)
    if reason:
        texts.append(reason)
    if verdict.registered_verdict not in ("", verdict.verdict):
        texts.append(f"by the registered margins: {_WORD_OF[verdict.registered_verdict]}")
    return texts


def letter(verdict: Verdict) -> str:
    """Return p for preregistered, d for descriptive, or the number of the list whose runs were known.

    A star follows if the claim was changed after its first run.
    """
    mark = _LETTERS.get(verdict.label, verdict.label.rpartition(" ")[2])
    return f"{mark}*" if verdict.changed else mark


def registration(verdict: Verdict) -> str:
    """Return whether a claim was stated before its runs, and what has changed since."""
    if not verdict.changed:
        return verdict.label
    return f"{verdict.label}; changed since the first run: {', '.join(verdict.changed)}"


def why(verdict: Verdict) -> str:
    """Return in a few words why a claim is not tested, or what its word does not tell; mostly empty."""
    if verdict.lacks_runs:
        return "partly trained" if verdict.run_ids else "not trained yet"
    if verdict.verdict == MIXED:
        return "its two measures disagree"
    reason = verdict.reason.partition(":")[0]
    if " seed " in reason:
        return "a run has no value"
    return _PLAIN_REASONS.get(reason, reason)


def details(verdict: Verdict) -> list[str]:
    """Return what is compared; for each contrast arms, numbers of runs, effect, margin; why there is none."""
    if verdict.lacks_runs:
        return [verdict.claim.context, verdict.reason]
    texts = [verdict.claim.context]
    for row in verdict.contrasts:
        runs = " and ".join(str(count) for count in row.contrast.seeds if count)
        text = f"{' against '.join(row.names)}, {runs} runs:"
        if row.has_effect:
            text += f" {effect(row)}"
        if row.contrast.reason:
            text += f" ({row.contrast.reason})"
        texts.append(text)
    return texts


# --- One effect ------------------------------------------------------------------------------------


def effect(row: ClaimContrast) -> str:
    """Return an effect in plain units, as 'kills 85 against 83 % (−1 to 5; ±7.1)'.

    In brackets stand the ends of the interval of the difference, the first less the second, which holds
    together with all others of its family; and the margin. Of logarithms they are factors.
    """
    if row.claim.kind == "hazard" or row.outcome in _LOGARITHMS:
        a, b, interval, margin = _factors(row)
    else:
        a, b, interval, margin = _numbers(row)
    if row.b:
        text = f"{_name(row)} {a.removesuffix(' %')} against {b}"
    elif row.other_outcome:
        text = f"{_name(row)} {a}, {_OUTCOME_NAMES.get(row.other_outcome, row.other_outcome)} {b}"
    elif row.value:
        text = f"{_name(row)} {a}, threshold {b}"
    else:
        text = f"{_name(row)} {a}"
    brackets = "; ".join(filter(None, (interval, margin)))
    return f"{text} ({brackets})" if brackets else text


def _numbers(row: ClaimContrast) -> tuple[str, str, str, str]:
    """Return both numbers, the interval of their difference, and the margin, as far as the interval knows."""
    contrast, ends = row.contrast, row.contrast.simultaneous
    is_share = row.claim.is_incidence or find_outcome(row.outcome).unit == "share"
    scale, unit = (100, " %") if is_share else (1, "")
    places = _places(scale * (contrast.means[0] - contrast.means[1]), scale * ends.low, scale * ends.high)
    if is_share:
        places = max(places, 0)
    a, b = (shown(scale * mean, places).replace("-", "−") + unit for mean in contrast.means)
    interval = margin = ""
    if ends.exists:
        interval = f"{_end(scale * ends.low, places)} to {_end(scale * ends.high, places)}"
    if row.margin:
        margin = f"±{shown(scale * row.margin, decimals(scale * row.margin) - 1)}"
    return a, b, interval.replace("-", "−"), margin


def _factors(row: ClaimContrast) -> tuple[str, str, str, str]:
    """Return the same of logarithms as factors; of a hazard both numbers are shares of runs."""
    contrast, ends = row.contrast, row.contrast.simultaneous
    if row.claim.kind == "hazard":
        a, b = (f"{100 * share:.0f} %" for share in contrast.means)
    else:
        a, b = (_factor(mean) for mean in contrast.means)
    interval = margin = ""
    if ends.exists:
        interval = f"{_factor(ends.low)} to {_factor(ends.high)} times"
    if row.margin:
        margin = f"×{_factor(row.margin)}"
    return a, b, interval, margin


def _end(end: float, places: int) -> str:
    """Return an end of an interval; one that would be 0 has a digit, which shows on which side of 0 it is."""
    if math.isfinite(end) and end and round(end, places) == 0:
        places = -math.floor(math.log10(abs(end)))
    return shown(end, min(places, MOST))


def _places(difference: float, low: float, high: float) -> int:
    """Return decimal places by which half an interval has one digit, or two if it begins with 1."""
    half = (high - low) / 2
    if not half > 0:
        return decimals(difference)
    places = min(MOST, -math.floor(math.log10(half / 2)))
    if round(difference, places) == 0:
        places += 1
    return places


def _factor(log: float) -> str:
    """Return a factor with two digits, given its logarithm."""
    if log > MOST_LOG:
        return "∞"
    factor = math.exp(log)
    return shown(factor, decimals(factor) - 1)


def _name(row: ClaimContrast) -> str:
    """Return the words for an outcome of a contrast, after those for its pair of arms."""
    event = row.claim.event(row.outcome)
    if f"{row.outcome} {event}" in _OUTCOME_NAMES:
        words = _OUTCOME_NAMES[f"{row.outcome} {event}"]
    elif row.outcome.startswith("steps-to:"):
        share = float(row.outcome.removeprefix("steps-to:"))
        words = f"steps to {100 * share:g} % of the monsters"
    else:
        words = _OUTCOME_NAMES.get(row.outcome) or find_outcome(row.outcome).words
        if event:
            words = f"runs with {words} {event}"
    if row.claim.kind in ("spread", "range"):
        words = f"{row.claim.kind} of {words}"
    pair_names = row.claim.called[2:]
    if row.claim.kind == "interaction":
        return f"effect on {words}, {' against '.join(pair_names)}:"
    if row.claim.kind in TOGETHER:
        return words
    for pair, name in zip(row.claim.pairs(row.outcome), pair_names, strict=False):
        if pair == (row.a, row.b):
            return f"{name}, {words}"
    return words


# --- Claims ----------------------------------------------------------------------------------------


def arms_in_words(claim: Claim) -> str:
    """Return what is compared, as 'tanh against ReLU'; one arm alone is held against a threshold."""
    if claim.called:
        first, second = claim.called[:2]
    else:
        first, second = _list_in_words(claim.a), _list_in_words(claim.b)
    return f"{first} against {second}" if second else first


def _list_in_words(names: Sequence[str]) -> str:
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


def sentence(claim: Claim) -> str:
    """Return the thesis's sentence without the marks of TeX and Markdown."""
    text = re.sub(r"\$\$.*?\$\$ *|_\{[^}]*\}|[*$]|\[\d+\]", "", claim.quote)
    text = re.sub(r"\\([a-z]+|\|) ?", lambda match: _SYMBOLS.get(match[1], match[1]), text)
    text = re.sub(r"_(\w)", lambda match: match[1].translate(_SUBSCRIPTS), text)
    return re.sub(r" (?=[,.;)])", "", " ".join(text.split()))


def short_sentence(claim: Claim) -> str:
    """Return the sentence with … where words are left out."""
    return claim.short or shorten(sentence(claim), LONGEST_SENTENCE, placeholder=" …")
