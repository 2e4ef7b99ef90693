"""Verdicts in plain words: the thesis's sentence, a word for each world, and the effect in plain units.

    [Verdict] → `verdict_table`, which pages, pictures, the report and `pneuma study verify` print alike

`docs/claims.md` explains how the words come from what the judge decides.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from textwrap import shorten

import pandas as pd

from pneuma.analysis.claims.claim_list import Claim
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
    HOLDS: "The runs show that the sentence is true.",
    FAILS: "The runs show the opposite, or that the difference is too small to matter.",
    UNDECIDED: "The runs show neither, or one measure supports the sentence and another contradicts it.",
    NOT_TESTED: "The runs are missing, or cannot show whether the sentence is true.",
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

_EVENTS = {"one-action above 0.9": "runs with one action"}
"""Events in fewer words than the outcome and the number have."""
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
        row = verdict.claim.row
        if verdict.world in by_claim.get(row, {}):
            row = verdict.claim.name
        by_claim.setdefault(row, {})[verdict.world] = verdict
    return by_claim


def _section_numbers(verdict: Verdict) -> list[int]:
    return list(map(int, re.findall(r"\d+", verdict.claim.section)))


def worlds_of(by_claim: ByClaim) -> dict[str, str]:
    """Return the names of the worlds in which claims were judged; statements of one's own may have none."""
    judged_in: set[str] = set()
    quotes: set[str] = set()
    for by_world in by_claim.values():
        judged_in.update(by_world)
        for verdict in by_world.values():
            quotes.add(verdict.claim.quote)
    if len(judged_in) == 1 and not any(quotes):
        return dict.fromkeys(judged_in, "verdict")
    return {world: name for world, name in WORLD_NAMES.items() if world in judged_in}


def count_words(by_claim: ByClaim) -> pd.DataFrame:
    """Return how many claims have each word, a row for each world."""
    worlds = worlds_of(by_claim)
    words: dict[str, list[str]] = {world: [] for world in worlds}
    for by_world in by_claim.values():
        for world, verdict in by_world.items():
            words[world].append(word(verdict))
    rows = [[worlds[world]] + list(map(words[world].count, WORDS)) for world in worlds]
    return pd.DataFrame(rows, columns=[""] + list(WORDS))


def verdict_table(by_claim: ByClaim) -> pd.DataFrame:
    """Return a row for each claim: section, sentence and arms, and for each world the word and effects."""
    worlds = worlds_of(by_claim)
    rows: list[list[str]] = []
    quoted: set[str] = set()
    for name, by_world in by_claim.items():
        claim = next(iter(by_world.values())).claim
        quote = short_sentence(claim)
        heading = claim.context or name
        if quote and quote not in quoted:
            heading = f"“{quote}”"
            quoted.add(quote)
        row = [claim.section, f"{heading}\n{arms_in_words(claim)}"]
        for world in worlds:
            verdict = by_world.get(world)
            row.append(cell(verdict) if verdict else "–")
        rows.append(row)
    columns = ["Section", "The thesis's sentence"] + list(worlds.values())
    if not quoted:
        columns[1] = "Claim"
    return pd.DataFrame(rows, columns=columns)


# --- One verdict -----------------------------------------------------------------------------------


def cell(verdict: Verdict) -> str:
    """Return a verdict's word and label; in the next lines its effects, or why there are none."""
    return "\n".join([f"{word(verdict)} [{letter(verdict)}]"] + lines(verdict))


def word(verdict: Verdict) -> str:
    return _WORD_OF[verdict.verdict]


def lines(verdict: Verdict) -> list[str]:
    """Return the effect of each outcome, if any was tested, and what must be added or stands instead."""
    texts: list[str] = []
    if word(verdict) != NOT_TESTED:
        tested = [row for row in verdict.deciding if row.has_effect]
        texts = list(map(effect, tested))
        if any(row.none_learned for row in tested):
            texts.append("none plays better than at random")
        for row in tested[:1]:
            first, second = row.contrast.seeds
            if second not in (0, first):
                texts.append(f"{first} against {second} runs")
    texts.append(why(verdict))
    if verdict.registered_verdict not in ("", verdict.verdict):
        texts.append(f"by the registered margins: {_WORD_OF[verdict.registered_verdict]}")
    return list(filter(None, texts))


def letter(verdict: Verdict) -> str:
    """Return p for preregistered, d for descriptive, or the number of the list whose runs were known.

    A star follows if the claim was changed after its first run.
    """
    mark = _LETTERS.get(verdict.label, verdict.label.rpartition(" ")[2])
    if verdict.changed:
        mark += "*"
    return mark


def registration(verdict: Verdict) -> str:
    """Return whether a claim was stated before its runs, and what has changed since."""
    if not verdict.changed:
        return verdict.label
    return f"{verdict.label}; changed since the first run: {', '.join(verdict.changed)}"


def why(verdict: Verdict) -> str:
    """Return in a few words why a claim is not tested, or what its word does not tell; mostly empty."""
    if verdict.lacks_runs and verdict.run_ids:
        return "partly trained"
    if verdict.lacks_runs:
        return "not trained yet"
    if verdict.verdict == MIXED:
        return "its two measures disagree"
    return verdict.reason.partition(":")[0]


def remedy(verdict: Verdict) -> list[str]:
    """Return the command that trains what is missing, if runs are."""
    if not verdict.lacks_runs:
        return []
    return [verdict.reason.rpartition("; ")[2]]


def details(verdict: Verdict) -> list[str]:
    """Return the sentence, what is compared, and for each contrast arms, numbers of runs and effect."""
    texts = [sentence(verdict.claim), verdict.claim.context]
    if verdict.lacks_runs:
        return texts + [verdict.reason]
    for row in verdict.contrasts:
        runs = " and ".join(map(str, filter(None, row.contrast.seeds)))
        phrases = [f"{' against '.join(row.names)}, {runs} runs:"]
        if row.has_effect:
            phrases.append(effect(row))
        if row.contrast.reason:
            phrases.append(f"({row.contrast.reason})")
        texts.append(" ".join(phrases))
    return texts


# --- One effect ------------------------------------------------------------------------------------


def effect(row: ClaimContrast) -> str:
    """Return an effect in plain units, as 'kills 85 against 83 % (−1 to 5; ±7.1)'.

    In brackets stand the ends of the interval of the difference, the first less the second, which holds
    together with all others of its family; and the margin. Of logarithms they are factors.
    """
    interval, margin = "{} to {}", "±{}"
    if row.claim.kind == "hazard" or row.outcome in _LOGARITHMS:
        interval, margin = "{} to {} times", "×{}"
        a, b, low, high, smallest = _factors(row)
    else:
        a, b, low, high, smallest = _numbers(row)
    brackets = []
    if row.contrast.simultaneous.exists:
        brackets.append(interval.format(low, high))
    if row.margin:
        brackets.append(margin.format(smallest))
    text = f"{_name(row)} {a}"
    if row.b:
        text = f"{text.removesuffix(' %')} against {b}"
    elif isinstance(row.value, str):
        text += f", {_outcome_words(row.value)} {b}"
    elif row.value:
        text += f", threshold {b}"
    if brackets:
        text += f" ({'; '.join(brackets)})"
    return text


def _numbers(row: ClaimContrast) -> list[str]:
    """Return both numbers, the ends of their difference's interval, and the margin, as known."""
    contrast, ends = row.contrast, row.contrast.simultaneous
    is_share = row.claim.is_incidence or find_outcome(row.outcome).unit == "share"
    scale, unit, least_digits = 1, "", -MOST
    if is_share:
        scale, unit, least_digits = 100, " %", 0
    first, second = scale * contrast.means[0], scale * contrast.means[1]
    low, high, margin = scale * ends.low, scale * ends.high, scale * (row.margin or 0.0)
    digits = max(_places(scale * (contrast.means[0] - contrast.means[1]), low, high), least_digits)
    texts = [shown(first, digits) + unit, shown(second, digits) + unit]
    texts += [_end(low, digits), _end(high, digits), shown(margin, decimals(margin) - 1)]
    return [text.replace("-", "−") for text in texts]


def _factors(row: ClaimContrast) -> list[str]:
    """Return the same of logarithms as factors; of a hazard both numbers are shares of runs."""
    contrast, ends = row.contrast, row.contrast.simultaneous
    factors = list(map(_factor, contrast.means + (ends.low, ends.high, row.margin or 0.0)))
    if row.claim.kind == "hazard":
        factors[:2] = [f"{100 * share:.0f} %" for share in contrast.means]
    return factors


def _end(end: float, digits: int) -> str:
    """Return an end of an interval; one that would be 0 has a digit, which shows on which side of 0 it is."""
    if math.isfinite(end) and end and round(end, digits) == 0:
        digits = -math.floor(math.log10(abs(end)))
    return shown(end, min(digits, MOST))


def _places(difference: float, low: float, high: float) -> int:
    """Return decimal places by which half an interval has one digit, or two if it begins with 1."""
    half = (high - low) / 2
    if not half > 0:
        return decimals(difference)
    digits = min(MOST, -math.floor(math.log10(half / 2)))
    if round(difference, digits) == 0:
        digits += 1
    return digits


def _factor(log: float) -> str:
    """Return a factor with two digits, given its logarithm."""
    if log > MOST_LOG:
        return "∞"
    factor = math.exp(log)
    return shown(factor, decimals(factor) - 1)


def _name(row: ClaimContrast) -> str:
    """Return the words for an outcome of a contrast, after those for its pair of arms."""
    claim, outcome = row.claim, row.outcome
    words = _outcome_words(outcome)
    if claim.event:
        words = _EVENTS.get(f"{outcome} {claim.event}", f"runs with {words} {claim.event}")
    if claim.kind in ("spread", "range"):
        words = f"{claim.kind} of {words}"
    pair_names = claim.called[2:]
    if claim.kind == "interaction":
        return f"effect on {words}, {' against '.join(pair_names)}:"
    if claim.paired and pair_names:
        return f"{pair_names[claim.a.index(row.a[0])]}, {words}"
    return words


def _outcome_words(name: str) -> str:
    if name.startswith("steps-to:"):
        return f"steps to {100 * float(name.removeprefix('steps-to:')):g} % of the monsters"
    return find_outcome(name).short or find_outcome(name).words


# --- Claims ----------------------------------------------------------------------------------------


def arms_in_words(claim: Claim) -> str:
    """Return what is compared, as 'tanh against ReLU'; one arm alone is held against a threshold."""
    first, second = " and ".join(claim.a), " and ".join(claim.b)
    if claim.called:
        first, second = claim.called[:2]
    if second:
        first += f" against {second}"
    return first


def sentence(claim: Claim) -> str:
    """Return the thesis's sentence without the marks of TeX and Markdown."""
    text = re.sub(r"\$\$.*?\$\$ *|_\{[^}]*\}|[*$]|\[\d+\]", "", claim.quote)
    text = re.sub(r"\\([a-z]+|\|) ?", lambda match: _SYMBOLS.get(match[1], match[1]), text)
    text = re.sub(r"_(\w)", lambda match: match[1].translate(_SUBSCRIPTS), text)
    return re.sub(r" (?=[,.;)])", "", " ".join(text.split()))


def short_sentence(claim: Claim) -> str:
    """Return the sentence with … where words are left out."""
    return claim.short or shorten(sentence(claim), LONGEST_SENTENCE, placeholder=" …")
