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
    grouped: dict[str, dict[str, Verdict]] = {}
    for verdict in sorted(verdicts, key=_section_numbers):
        grouped.setdefault(verdict.claim.row, {})[verdict.world] = verdict
    return grouped


def _section_numbers(verdict: Verdict) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", verdict.claim.section)]


def first_claim(name: str, judged: Mapping[str, Verdict]) -> Claim:
    """Return the claim of a row: the one that others are like, or the first of these without it."""
    claims = {verdict.claim.name: verdict.claim for verdict in judged.values()}
    return claims.get(name) or next(iter(claims.values()))


def worlds_of(claims: ByClaim) -> dict[str, str]:
    """Return the names of the worlds in which claims were judged; statements of one's own may have none."""
    verdicts = [verdict for judged in claims.values() for verdict in judged.values()]
    judged_in = {verdict.world for verdict in verdicts}
    if len(judged_in) == 1 and not any(verdict.claim.quote for verdict in verdicts):
        return dict.fromkeys(judged_in, "verdict")
    return {world: WORLD_NAMES[world] for world in WORLDS if world in judged_in}


def count_words(claims: ByClaim) -> pd.DataFrame:
    """Return how many claims have each word, a row for each world."""
    rows = []
    for world, name in worlds_of(claims).items():
        counts = Counter(word(judged[world]) for judged in claims.values() if world in judged)
        rows.append([name, *(counts[one] for one in WORDS)])
    return pd.DataFrame(rows, columns=["", *WORDS])


def verdict_table(claims: ByClaim, whole: bool = False) -> pd.DataFrame:
    """Return a row for each claim: section, sentence and arms, and for each world the word and effects.

    With `whole`, sentences are not shortened.
    """
    worlds = worlds_of(claims)
    rows: list[list[str]] = []
    quoted: set[str] = set()
    for name, judged in claims.items():
        claim = first_claim(name, judged)
        quote = sentence(claim) if whole else short_sentence(claim)
        heading = claim.context or name
        if quote not in ("", *quoted):
            heading = f"“{quote}”"
            quoted.add(quote)
        cells = [cell(judged.get(world)) for world in worlds]
        rows.append([claim.section, f"{heading}\n{arms_in_words(claim)}", *cells])
    heading = "The thesis's sentence" if quoted else "Claim"
    return pd.DataFrame(rows, columns=["Section", heading, *worlds.values()])


# --- One verdict -----------------------------------------------------------------------------------


def cell(verdict: Verdict | None) -> str:
    """Return a verdict's word and label; in the next lines its effects, or why there are none."""
    if verdict is None:
        return "–"
    return "\n".join([f"{word(verdict)} [{letter(verdict)}]", *lines(verdict)])


def word(verdict: Verdict) -> str:
    return _WORD_OF[verdict.verdict]


def lines(verdict: Verdict) -> list[str]:
    """Return the effect of each outcome, if any was tested, and what must be added or stands instead."""
    tested: list[ClaimContrast] = []
    if word(verdict) != NOT_TESTED:
        tested = [row for row in verdict.deciding if row.has_effect]
    texts = [effect(row) for row in tested]
    if any(row.none_learned for row in tested):
        texts.append("none plays better than at random")
    texts.append(why(verdict))
    unequal = [row.contrast.seeds for row in tested if 0 < row.contrast.seeds[1] != row.contrast.seeds[0]]
    if unequal:
        texts.append("{} against {} runs".format(*unequal[0]))
    if verdict.registered_verdict not in ("", verdict.verdict):
        texts.append(f"by the registered margins: {_WORD_OF[verdict.registered_verdict]}")
    return [text for text in texts if text]


def letter(verdict: Verdict) -> str:
    """Return p for preregistered, d for descriptive, or the number of the list whose runs were known.

    A star follows if the claim was changed after its first run.
    """
    mark = _LETTERS.get(verdict.label, verdict.label.rpartition(" ")[2])
    return f"{mark}*" if verdict.changed else mark


def registration(verdict: Verdict) -> str:
    """Return whether a claim was stated before its runs, and what has changed since."""
    changed = ", ".join(verdict.changed or ())
    return f"{verdict.label}; changed since the first run: {changed}" if changed else verdict.label


def why(verdict: Verdict) -> str:
    """Return in a few words why a claim is not tested, or what its word does not tell; mostly empty."""
    if verdict.lacks_runs:
        return "partly trained" if verdict.run_ids else "not trained yet"
    if verdict.verdict == MIXED:
        return "its two measures disagree"
    reason = verdict.reason.partition(":")[0]
    return "a run has no value" if " seed " in reason else _PLAIN_REASONS.get(reason, reason)


def details(verdict: Verdict) -> list[str]:
    """Return what is compared; for each contrast arms, numbers of runs, effect, margin; why there is none."""
    texts = [verdict.claim.context]
    if verdict.lacks_runs:
        return [*texts, verdict.reason]
    for row in verdict.contrasts:
        parts = [row.contrast.reason]
        if row.has_effect:
            parts = [effect(row), row.contrast.reason]
        runs = " and ".join(str(count) for count in row.contrast.seeds if count)
        texts.append(f"{' against '.join(row.names)}, {runs} runs: {'; '.join(filter(None, parts))}")
    return texts


def effect(row: ClaimContrast) -> str:
    """Return an effect in plain units, as 'kills 85 against 83 % (−1 to 5; ±7.1)'.

    In brackets stand the ends of the interval of the difference, the first less the second, which holds
    together with all others of its family; and the margin. Of logarithms they are factors.
    """
    contrast = row.contrast
    ends = contrast.simultaneous.low, contrast.simultaneous.high
    is_share = row.claim.is_incidence or find_outcome(row.outcome).unit == "share"
    is_factor = row.claim.kind == "hazard" or row.outcome in _LOGARITHMS
    unit = " %" if is_share or row.claim.kind == "hazard" else ""
    if is_factor:
        a, b = (f"{100 * mean:.0f}" if unit else _factor(mean) for mean in contrast.means)
        low, high = (_factor(end) for end in ends)
        margin = f"×{_factor(row.margin)}" if row.margin else ""
    else:
        scale = 100 if is_share else 1
        means = [scale * mean for mean in contrast.means]
        a, b, low, high = _in_digits(means, [scale * end for end in ends], whole=is_share)
        margin = f"±{shown(scale * row.margin, decimals(scale * row.margin) - 1)}" if row.margin else ""
    interval = f"{low} to {high}" if contrast.simultaneous.exists else ""
    if interval and is_factor:
        interval += " times"
    brackets = "; ".join(part for part in (interval, margin) if part)
    name = _name(row)
    if row.b:
        text = f"{name} {a} against {b}{unit}"
    elif row.other_outcome:
        text = f"{name} {a}{unit}, {_OUTCOME_NAMES.get(row.other_outcome, row.other_outcome)} {b}{unit}"
    elif row.value:
        text = f"{name} {a}{unit}, threshold {b}{unit}"
    else:
        text = f"{name} {a}{unit}"
    return f"{text} ({brackets})" if brackets else text


def _in_digits(means: Sequence[float], ends: Sequence[float], whole: bool) -> list[str]:
    """Return two numbers and the ends of the interval of their difference, as far as it is known."""
    places = _places(means[0] - means[1], *ends)
    if whole:
        places = max(places, 0)
    texts = [shown(mean, places) for mean in means] + [_end(end, places) for end in ends]
    return [text.replace("-", "−") for text in texts]


def _end(end: float, places: int) -> str:
    """Return an end of an interval; one that would be 0 has a digit, which shows on which side of 0 it is."""
    if math.isfinite(end) and end and round(end, places) == 0:
        places = -math.floor(math.log10(abs(end)))
    return shown(end, min(places, MOST))


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


def _name(row: ClaimContrast) -> str:
    """Return the words for an outcome of a contrast, after those for its pair of arms."""
    event = row.claim.event(row.outcome)
    words = _OUTCOME_NAMES.get(f"{row.outcome} {event}".strip(), "")
    if row.outcome.startswith("steps-to:"):
        words = f"steps to {100 * float(row.outcome.partition(':')[2]):g} % of the monsters"
    if not words:
        words = _OUTCOME_NAMES.get(row.outcome, find_outcome(row.outcome).words)
        words = f"runs with {words} {event}" if event else words
    if row.claim.kind in ("spread", "range"):
        words = f"{row.claim.kind} of {words}"
    if row.claim.kind == "interaction":
        words = f"difference of {words}, {' against '.join(row.claim.called[2:])}"
    pair_names = dict(zip(row.claim.pairs(row.outcome), row.claim.called[2:], strict=False))
    pair = pair_names.get((row.a, row.b))
    return f"{pair}, {words}" if pair else words


# --- Claims ----------------------------------------------------------------------------------------


def arms_in_words(claim: Claim) -> str:
    """Return what is compared, as 'tanh against ReLU'; one arm alone is held against a threshold."""
    first, second = claim.called[:2] if claim.called else (_arm(claim.a), _arm(claim.b))
    return f"{first} against {second}" if second else first


def _arm(conditions: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(conditions[:-1]), *conditions[-1:])))


def sentence(claim: Claim) -> str:
    """Return the thesis's sentence without the marks of TeX and Markdown."""
    text = re.sub(r"\$\$.*?\$\$ *|_\{[^}]*\}|[*$]|\[\d+\]", "", claim.quote)
    text = re.sub(r"\\([a-z]+|\|) ?", lambda match: _SYMBOLS.get(match[1], match[1]), text)
    text = re.sub(r"_(\w)", lambda match: match[1].translate(_SUBSCRIPTS), text)
    return re.sub(r" (?=[,.;)])", "", " ".join(text.split()))


def short_sentence(claim: Claim) -> str:
    """Return the sentence with … where words are left out."""
    return claim.short or shorten(sentence(claim), LONGEST_SENTENCE, placeholder=" …")
