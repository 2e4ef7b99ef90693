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

from pneuma.analysis.claims.claim_list import MINUS, Arms, Claim
from pneuma.analysis.claims.table import ClaimContrast
from pneuma.analysis.claims.verdicts import (
    INCONCLUSIVE,
    MIXED,
    REFUTED,
    SUPPORTED,
    UNTESTABLE,
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
_WORD_OF = {
    SUPPORTED: HOLDS, REFUTED: FAILS, MIXED: UNDECIDED, INCONCLUSIVE: UNDECIDED, UNTESTABLE: NOT_TESTED,
}  # fmt: skip

WORLD_NAMES = {
    name: world.title.removeprefix("the ").removesuffix("'s world") for name, world in WORLDS.items()
}
"""Heads of columns: text, published code, arena."""

_PLAIN_REASONS = {
    "not admitted": "too few runs",
    "arm at floor": "the agents learned nothing there",
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
    "final-commonest-action above 0.9": "runs that end in one action",
    "low-entropy-share above 0.05": "runs without entropy",
    "log-max-kl": "largest change of policy (KL)",
    "early-explained-variance": "variance that the critic explains at first",
    "steps-to:0.23": "steps to 23 % of the monsters",
    "steps-to:0.34": "steps to 34 % of the monsters",
    "steps-to:0.43": "steps to 43 % of the monsters",
    "steps-to:0.47": "steps to 47 % of the monsters",
}
"""Outcomes in fewer words than `OUTCOMES` has."""
_OF_KIND = {"spread": "spread of {}", "range": "range of {}"}
MOST_LOG = 23.0
"""Factors above ten thousand million are told as infinite."""
_LOGARITHMS = ("grad-norm-growth", "log-max-grad-norm", "log-max-kl")


def verdicts_by_claim(verdicts: Iterable[Verdict]) -> dict[str, dict[str, Verdict]]:
    """Return verdicts by claim and world, the claims in the order of the thesis's sections.

    Those of a claim that is like another stand with the other's.
    """
    grouped: dict[str, dict[str, Verdict]] = {}
    for one in sorted(verdicts, key=lambda one: [*map(int, re.findall(r"\d+", one.claim.section))]):
        grouped.setdefault(one.claim.row, {})[one.world] = one
    return grouped


def first_claim(name: str, judged: Mapping[str, Verdict]) -> Claim:
    """Return the claim of a row: the one that others are like, or the first of these without it."""
    of_row = [one.claim for one in judged.values()]
    return next((claim for claim in of_row if claim.name == name), of_row[0])


def worlds_of(claims: Mapping[str, Mapping[str, Verdict]]) -> dict[str, str]:
    """Return the names of the worlds in which claims were judged; statements of one's own may have none."""
    judged = {world: one.claim for worlds in claims.values() for world, one in worlds.items()}
    if len(judged) == 1 and not any(claim.quote for claim in judged.values()):
        return dict.fromkeys(judged, "verdict")
    return {world: WORLD_NAMES[world] for world in WORLDS if world in judged}


def count_words(claims: Mapping[str, Mapping[str, Verdict]]) -> pd.DataFrame:
    """Return how many claims have each word, a row for each world."""
    rows = []
    for world, called in worlds_of(claims).items():
        counts = Counter(word(worlds[world]) for worlds in claims.values() if world in worlds)
        rows.append([called, *(counts[each] for each in WORDS)])
    return pd.DataFrame(rows, columns=["", *WORDS])


def verdict_table(claims: Mapping[str, Mapping[str, Verdict]], whole: bool = False) -> pd.DataFrame:
    """Return a row for each claim: section, sentence and arms, and for each world the word and effects.

    With `whole`, sentences are not shortened.
    """
    columns, rows, quoted = worlds_of(claims), [], set()
    for name, judged in claims.items():
        claim = first_claim(name, judged)
        quote = f"“{sentence(claim) if whole else short_sentence(claim)}”" if claim.quote else name
        shown = claim.context if quote in quoted and claim.context else quote
        quoted.add(quote)
        rows.append(
            [
                claim.section,
                f"{shown}\n{arms_in_words(claim)}",
                *(cell(judged.get(world)) for world in columns),
            ]
        )
    heads = ["Section", "The thesis's sentence" if quoted - {*claims} else "Claim", *columns.values()]
    return pd.DataFrame(rows, columns=heads)


def cell(verdict: Verdict | None) -> str:
    """Return a verdict's word, and in the next lines its effects, or why there are none."""
    return "–" if verdict is None else "\n".join(filter(None, (word(verdict), text(verdict))))


# --- One verdict -----------------------------------------------------------------------------------


def word(verdict: Verdict) -> str:
    return _WORD_OF[verdict.verdict]


def text(verdict: Verdict) -> str:
    """Return the effect of each outcome, if any was tested, and what must be said beside or instead."""
    tested = [row for row in verdict.deciding if row.has_effect and word(verdict) != NOT_TESTED]
    idle = "none plays better than at random" if any(row.none_learned for row in tested) else ""
    return "\n".join(filter(None, (*map(effect, tested), idle, why(verdict))))


def why(verdict: Verdict) -> str:
    """Return in a few words why a claim is not tested, or what its word does not say; mostly empty."""
    if verdict.lacks_runs:
        return "partly trained" if verdict.run_ids else "not trained yet"
    if verdict.verdict == MIXED:
        return "its two measures disagree"
    reason = verdict.reason.partition(":")[0]
    return "a run has no value" if " seed " in reason else _PLAIN_REASONS.get(reason, reason)


def effect(row: ClaimContrast) -> str:
    """Return an effect in plain units, as 'kills 85 against 83 %: +2 points (−1 to 5)'.

    It is the first less the second. The interval is the one that holds together with all others of the world.
    """
    contrast, alone = row.contrast, not row.b and row.value == 0
    numbers = [*contrast.means, contrast.effect, contrast.simultaneous.low, contrast.simultaneous.high]
    unit = difference = ""
    if row.outcome in _LOGARITHMS and row.claim.kind == "mean":
        a, b, size, low, high = (_factor(number) for number in numbers)
        difference = " times as much"
    else:
        if row.claim.counts or find_outcome(row.outcome.split(MINUS)[0]).unit == "share":
            numbers, unit, difference = [100 * number for number in numbers], " %", " points"
        places = max(_places(*numbers[2:]), 0) if unit else _places(*numbers[2:])
        a, b, size = (shown(number, places).replace("-", "−") for number in numbers[:3])
        low, high = (_end(end, places) for end in numbers[3:])
        size = size if alone or size.startswith("−") or not size.strip("0.") else f"+{size}"
    between = f" ({low} to {high})" if contrast.simultaneous.exists else ""
    if alone:
        return f"{_said(row)} {size}{unit}{between}"
    both = f"{a} against {b}" if row.b else f"{a}{unit}, threshold {b}"
    return f"{_said(row)} {both}{unit}: {size}{difference}{between}"


def arms_in_words(claim: Claim) -> str:
    """Return what is compared, as 'tanh against ReLU'; one arm alone is held against a threshold."""
    first, second = claim.called[:2] if claim.called else (_arm(claim.a), _arm(claim.b) if claim.b else "")
    return f"{first} against {second}" if second else first


def _arm(conditions: Arms) -> str:
    return " and ".join(filter(None, (", ".join(conditions[:-1]), conditions[-1])))


def _said(row: ClaimContrast) -> str:
    event = row.claim.event(row.outcome)
    named = f"{row.outcome} {event}".strip()
    words = _SAID.get(named) or " less ".join(
        _SAID.get(part, find_outcome(part).words) for part in row.outcome.split(MINUS)
    )
    if event and named not in _SAID:
        words = f"runs with {words} {event}"
    pair = dict(zip(row.claim.pairs, row.claim.called[2:], strict=False)).get((row.a, row.b), "")
    return ", ".join(filter(None, [pair, _OF_KIND.get(row.claim.kind, "{}").format(words)]))


def _end(end: float, places: int) -> str:
    """Return an end of an interval; one that would be 0 has a digit, which tells on which side of 0 it is."""
    if math.isfinite(end) and end and round(end, places) == 0:
        places = -math.floor(math.log10(abs(end)))
    return shown(end, min(places, MOST)).replace("-", "−")


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
    return claim.short or shorten(sentence(claim), LONGEST_SENTENCE, placeholder=" …")


LONGEST_SENTENCE = 160
_SUBSCRIPTS = str.maketrans("012t", "₀₁₂ₜ")
_SYMBOLS = {"tanh": "tanh ", "beta": "β", "nabla": "∇", "vartheta": "ϑ", "leq": "≤ ", "|": "‖"}
