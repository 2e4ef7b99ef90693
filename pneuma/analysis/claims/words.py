"""Verdicts in plain words: the thesis's sentence, a word for each world, and the effect in plain units.

    [Verdict] → [SentenceRow] → `verdict_table`; pages, pictures, report and `study verify` show these

`docs/claims.md` explains how the words come from what the judge decides.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from textwrap import shorten

import pandas as pd

from pneuma.analysis.claims.claim_list import Claim
from pneuma.analysis.claims.contrasts import LOGARITHMIC
from pneuma.analysis.claims.verdicts import (
    AMENDED,
    DESCRIPTIVE,
    FAILS,
    HOLDS,
    NOT_TESTED,
    PREREGISTERED,
    SINCE_THEN,
    UNDECIDED,
    UNVERIFIED,
    ClaimContrast,
    Verdict,
)
from pneuma.analysis.intervals import MOST_DECIMALS, decimals, number_text
from pneuma.analysis.outcomes import find_outcome
from pneuma.presets import WORLDS

WORDS = {
    HOLDS: "The runs show that the sentence is true.",
    FAILS: "The runs show the opposite, or that the difference is too small to matter.",
    UNDECIDED: "The runs show neither, or one measure supports the sentence and another contradicts it.",
    NOT_TESTED: "The runs are missing, or cannot show whether the sentence is true.",
}
"""The four words, and what each means for a sentence in a world."""
RULE = (
    "A claim holds if the interval lies on the claimed side of 0 (or of the threshold) and reaches beyond "
    "the margin; it does not hold if the interval lies on the other side, or within the margin; of two "
    "measures one suffices if the other does not speak against it, and where no agent beats the random "
    "player an interval within the margin decides nothing."
)
"""How a verdict follows from interval and margin."""
LABELS = {
    PREREGISTERED: "stated before its runs were trained",
    AMENDED: "the same, but seeds, margins or rules were changed when runs were known",
    "same runs as list 3": "its runs were known: the third list had fixed them for another form of it",
    DESCRIPTIVE: "stated, or changed in more than that, when its runs were known, so it tests nothing",
    UNVERIFIED: "no commit shows which came first",
}
"""What each label means."""
_LETTERS = {PREREGISTERED: "p", AMENDED: "a", DESCRIPTIVE: "d", UNVERIFIED: "u"}

WORLD_NAMES = {
    name: world.title.removeprefix("the ").removesuffix("'s world") for name, world in WORLDS.items()
}
"""Heads of columns: text, published code, arena."""

_EVENTS = {"one-action above 0.9": "runs with one action"}
"""Events in fewer words than the outcome and the number have."""
MOST_LOG = 23.0
"""Factors above ten thousand million are shown as infinite."""
_LOGARITHMS = ("grad-norm-growth", "log-max-grad-norm", "log-max-kl")

ERRATA = {"To combat this issue, we used": "To combat this, we used"}
"""Words that lists quote wrongly, with the thesis's own. The lists stay as they were registered."""
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
        claim_name = verdict.claim.row
        if verdict.world in by_claim.get(claim_name, {}):
            claim_name = verdict.claim.name
        by_claim.setdefault(claim_name, {})[verdict.world] = verdict
    return by_claim


def _section_numbers(verdict: Verdict) -> list[int]:
    return list(map(int, re.findall(r"\d+", verdict.claim.section)))


def worlds_of(by_claim: ByClaim) -> dict[str, str]:
    """Return the names of the worlds in which claims were judged: "verdict" for unquoted claims in one."""
    judged_worlds: set[str] = set()
    quotes: set[str] = set()
    for by_world in by_claim.values():
        judged_worlds.update(by_world)
        for verdict in by_world.values():
            quotes.add(verdict.claim.quote)
    if len(judged_worlds) == 1 and not any(quotes):
        return dict.fromkeys(judged_worlds, "verdict")
    return {world: world_name for world, world_name in WORLD_NAMES.items() if world in judged_worlds}


def count_words(by_claim: ByClaim) -> pd.DataFrame:
    """Return how many claims have each word, a row for each world."""
    worlds = worlds_of(by_claim)
    words_by_world: dict[str, list[str]] = {world: [] for world in worlds}
    for by_world in by_claim.values():
        for world, verdict in by_world.items():
            words_by_world[world].append(verdict.verdict)
    count_rows = [[worlds[world]] + list(map(words_by_world[world].count, WORDS)) for world in worlds]
    return pd.DataFrame(count_rows, columns=[""] + list(WORDS))


@dataclass(frozen=True)
class SentenceRow:
    """A row of a table of verdicts: a sentence of the thesis, or a part of one, or a claim without a quote.

    Attributes:
        heading: the sentence, if no row above has it; else what distinguishes the claim.
        claims: the names of the claims on it.
        verdicts: those in each world.
    """

    heading: str
    claims: tuple[str, ...]
    verdicts: Mapping[str, Sequence[Verdict]]

    @property
    def claim(self) -> Claim:
        """The first of its claims."""
        return next(iter(self.verdicts.values()))[0].claim


def sentence_rows(by_claim: ByClaim) -> list[SentenceRow]:
    """Return the rows of a table of verdicts.

    A claim without a quote stands with an earlier one that compares the same conditions of the same study.
    """
    claims_by_row: dict[tuple[str, ...], list[str]] = {}
    quoted_rows: dict[tuple[object, ...], tuple[str, ...]] = {}
    for claim_name, by_world in by_claim.items():
        claim = next(iter(by_world.values())).claim
        compared = claim.study, claim.a, claim.b
        row_key: tuple[str, ...] = (sentence(claim), claim.short)
        if claim.quote:
            quoted_rows.setdefault(compared, row_key)
        else:
            row_key = quoted_rows.get(compared, (claim_name,))
        claims_by_row.setdefault(row_key, []).append(claim_name)
    rows: list[SentenceRow] = []
    quoted_sentences = {""}
    for claim_names in claims_by_row.values():
        verdicts: dict[str, list[Verdict]] = {}
        for claim_name in claim_names:
            for world, verdict in by_claim[claim_name].items():
                verdicts.setdefault(world, []).append(verdict)
        claim = next(iter(by_claim[claim_names[0]].values())).claim
        sentence_text = short_sentence(claim)
        heading = claim.context or claim_names[0]
        if sentence_text not in quoted_sentences:
            heading = f"“{sentence_text}”"
            quoted_sentences.add(sentence_text)
        rows.append(SentenceRow(heading, tuple(claim_names), verdicts))
    return rows


def verdict_table(by_claim: ByClaim) -> pd.DataFrame:
    """Return a row for each sentence: section, sentence, conditions, and for each world words and effects."""
    worlds, rows = worlds_of(by_claim), sentence_rows(by_claim)
    verdict_rows: list[list[str]] = []
    for row in rows:
        verdict_row = [row.claim.section, f"{row.heading}\n{compared_text(row.claim)}"]
        verdict_row += ["\n".join(_cells(row.verdicts.get(world, ()))) or "–" for world in worlds]
        verdict_rows.append(verdict_row)
    heading = "The thesis's sentence" if any(short_sentence(row.claim) for row in rows) else "Claim"
    return pd.DataFrame(verdict_rows, columns=["Section", heading, *worlds.values()])


def _cells(verdicts: Sequence[Verdict]) -> list[str]:
    """Return the cell of each verdict; with the claim's list and name if there are several.

    Claims of one list that are not trained yet stand together.
    """
    if len(verdicts) == 1:
        return [cell(verdicts[0])]
    cells: dict[str, None] = {}
    for verdict in verdicts:
        name = list_and_name(verdict.claim)
        if verdict.lacks_runs and not verdict.run_ids:
            name = verdict.claim.list_name
        cells[f"{name}: {cell(verdict)}"] = None
    return list(cells)


def list_and_name(claim: Claim) -> str:
    """Return a claim's name after that of its list, as 'fifth list, betas-cure'."""
    return ", ".join(filter(None, [claim.list_name, claim.name]))


# --- One verdict -----------------------------------------------------------------------------------


def cell(verdict: Verdict) -> str:
    """Return a verdict's word and label; in the next lines its effects, or why there are none."""
    return "\n".join([f"{verdict.verdict} [{letter(verdict)}]"] + lines(verdict))


def lines(verdict: Verdict) -> list[str]:
    """Return the effect of each outcome if one was tested, then what qualifies it, or why none was tested."""
    cell_lines: list[str] = []
    if verdict.verdict != NOT_TESTED:
        tested_contrasts = [
            claim_contrast for claim_contrast in verdict.deciding if claim_contrast.has_effect
        ]
        cell_lines = list(map(effect, tested_contrasts))
        if any(claim_contrast.none_learned for claim_contrast in tested_contrasts):
            cell_lines.append("none beats random")
        for claim_contrast in tested_contrasts[:1]:
            seeds_a, seeds_b = claim_contrast.contrast.seeds
            if seeds_b not in (0, seeds_a):
                cell_lines.append(f"{seeds_a} against {seeds_b} runs")
    cell_lines.append(why(verdict))
    if verdict.registered_verdict not in ("", verdict.verdict):
        reasons = " and ".join(SINCE_THEN[rule_change] for rule_change in verdict.rule_changes)
        since_then = f"; since then {reasons}" if reasons else ""
        cell_lines.append(f"as registered: {verdict.registered_verdict}{since_then}")
    return list(filter(None, cell_lines))


def letter(verdict: Verdict) -> str:
    """Return the first letter of a label, or the number of the list whose runs were known.

    A star follows if the claim was changed after its first run, unless the label says so.
    """
    label_letter = _LETTERS.get(verdict.label, verdict.label.rpartition(" ")[2])
    if verdict.changed and verdict.label != AMENDED:
        label_letter += "*"
    return label_letter


def registration(verdict: Verdict) -> str:
    """Return whether a claim was stated before its runs, and what has changed since."""
    if not verdict.changed:
        return verdict.label
    return f"{verdict.label}; changed since the first run: {', '.join(verdict.changed)}"


def why(verdict: Verdict) -> str:
    """Return in a few words why a claim is not tested, or what qualifies its word; mostly empty."""
    if verdict.lacks_runs and verdict.run_ids:
        return "partly trained"
    if verdict.lacks_runs:
        return "not trained yet"
    return verdict.reason.partition(":")[0]


def remedy(verdict: Verdict) -> list[str]:
    """Return the command that trains what is missing, if runs are."""
    if not verdict.lacks_runs:
        return []
    return [verdict.reason.rpartition("; ")[2]]


def details(verdict: Verdict) -> list[str]:
    """Return the sentence, its context, and for each contrast conditions and numbers of runs.

    Its effect follows if `lines` has it not, as it does not decide.
    """
    detail_lines = [sentence(verdict.claim), erratum(verdict.claim), verdict.claim.context]
    if verdict.lacks_runs:
        return detail_lines + [verdict.reason]
    labels = verdict.condition_labels
    for claim_contrast in verdict.contrasts:
        names = []
        for listed_names in claim_contrast.names:
            names.append(", ".join(labels.get(name, name) for name in listed_names.split(", ")))
        run_counts = " and ".join(map(str, filter(None, claim_contrast.contrast.seeds)))
        detail_line = f"{' against '.join(names)}, {run_counts} runs"
        is_deciding = any(claim_contrast is deciding for deciding in verdict.deciding)
        if claim_contrast.has_effect and not is_deciding:
            detail_line += f": {effect(claim_contrast)}"
        if claim_contrast.contrast.reason:
            detail_line += f" ({claim_contrast.contrast.reason})"
        detail_lines.append(detail_line)
    return list(dict.fromkeys(detail_lines))


# --- One effect ------------------------------------------------------------------------------------


def effect(claim_contrast: ClaimContrast) -> str:
    """Return an effect in plain units, as 'kills 85 against 83 % (−1 to 5; ±7.1)'.

    In brackets: the interval of the difference, the first minus the second, which holds jointly with all
    others of its family; and the margin. For logarithms they are factors. If there is only a threshold the
    interval is that of the value.
    """
    has_threshold = not claim_contrast.b and not isinstance(claim_contrast.value, str)
    interval_format, margin_format = "{} to {}", "±{}"
    if claim_contrast.claim.kind in LOGARITHMIC or claim_contrast.outcome in _LOGARITHMS:
        margin_format = "×{}"
        if not has_threshold:
            interval_format = "{} to {} times"
        a, b, low, high, smallest = _factors(claim_contrast, has_threshold)
    else:
        a, b, low, high, smallest = _numbers(claim_contrast, has_threshold)
    brackets = []
    if claim_contrast.contrast.simultaneous.exists:
        brackets.append(interval_format.format(low, high))
    if claim_contrast.margin:
        brackets.append(margin_format.format(smallest))
    effect_text, threshold = f"{_name(claim_contrast)} {a}", ""
    if claim_contrast.b:
        effect_text = f"{effect_text.removesuffix(' %')} against {b}"
    elif isinstance(claim_contrast.value, str):
        effect_text += f", {_outcome_words(claim_contrast.value)} {b}"
    elif claim_contrast.value:
        threshold = f", threshold {b}"
    if brackets:
        effect_text += f" ({'; '.join(brackets)})"
    return effect_text + threshold


def _numbers(claim_contrast: ClaimContrast, has_threshold: bool) -> list[str]:
    """Return both numbers, the ends of the interval that is shown, and the margin, as known."""
    contrast, interval = claim_contrast.contrast, claim_contrast.contrast.simultaneous
    if has_threshold:
        interval = interval.minus(-contrast.means[1])
    is_share = claim_contrast.claim.is_incidence or find_outcome(claim_contrast.outcome).unit == "share"
    scale, unit, least_digits = 1, "", -MOST_DECIMALS
    if is_share:
        scale, unit, least_digits = 100, " %", 0
    mean_a, mean_b = scale * contrast.means[0], scale * contrast.means[1]
    low, high, margin = scale * interval.low, scale * interval.high, scale * (claim_contrast.margin or 0.0)
    digits = max(_places(scale * (contrast.means[0] - contrast.means[1]), low, high), least_digits)
    number_texts = [number_text(mean_a, digits) + unit, number_text(mean_b, digits) + unit]
    if has_threshold:
        number_texts[1] = number_text(mean_b, decimals(mean_b) - 1) + unit
    number_texts += [_end(low, digits), _end(high, digits), number_text(margin, decimals(margin) - 1)]
    return [number_text.replace("-", "−") for number_text in number_texts]


def _factors(claim_contrast: ClaimContrast, has_threshold: bool) -> list[str]:
    """Return the same of logarithms as factors.

    Both numbers of a hazard are shares of runs, and those of a spread mean distances.
    """
    contrast, interval = claim_contrast.contrast, claim_contrast.contrast.simultaneous
    if has_threshold:
        interval = interval.minus(-contrast.means[1])
    factors = list(map(_factor, contrast.means + (interval.low, interval.high, claim_contrast.margin or 0.0)))
    if not has_threshold:
        factors[2:4] = _end_factor(interval.low), _end_factor(interval.high)
    if claim_contrast.claim.kind == "hazard":
        factors[:2] = [f"{100 * share:.0f} %" for share in contrast.means]
    if claim_contrast.claim.kind == "spread":
        factors[:2] = _distances(claim_contrast)
    return factors


def _distances(claim_contrast: ClaimContrast) -> list[str]:
    """Return both mean distances of a spread, with two digits in the smaller one."""
    scale, unit = 1, ""
    if find_outcome(claim_contrast.outcome).unit == "share":
        scale, unit = 100, " %"
    mean_distances = [scale * mean for mean in claim_contrast.contrast.means]
    digits = max(decimals(mean) for mean in mean_distances) - 1
    return [number_text(mean, digits) + unit for mean in mean_distances]


def _end(end: float, digits: int) -> str:
    """Return an end of an interval; one that would be 0 has a digit, which shows on which side of 0 it is."""
    if math.isfinite(end) and end and round(end, digits) == 0:
        digits = -math.floor(math.log10(abs(end)))
    return number_text(end, min(digits, MOST_DECIMALS))


def _places(difference: float, low: float, high: float) -> int:
    """Return decimal places by which half an interval has one digit, or two if it begins with 1."""
    half_width = (high - low) / 2
    if not half_width > 0:
        return decimals(difference)
    digits = min(MOST_DECIMALS, -math.floor(math.log10(half_width / 2)))
    if round(difference, digits) == 0:
        digits += 1
    return digits


def _factor(logarithm: float) -> str:
    """Return a factor with two digits, given its logarithm."""
    if logarithm > MOST_LOG:
        return "∞"
    factor = math.exp(logarithm)
    return number_text(factor, decimals(factor) - 1)


def _end_factor(logarithm: float) -> str:
    """Return an end of an interval; one that would be 1 has digits that show on which side of 1 it is."""
    factor_text, distance = _factor(logarithm), abs(math.exp(logarithm) - 1)
    if factor_text == "1.0" and distance:
        factor_text = number_text(math.exp(logarithm), min(-math.floor(math.log10(distance)), MOST_DECIMALS))
    return factor_text


def _name(claim_contrast: ClaimContrast) -> str:
    """Return the words for an outcome of a contrast, after those for its pair of conditions."""
    claim, outcome = claim_contrast.claim, claim_contrast.outcome
    outcome_words = _outcome_words(outcome)
    if claim.event:
        outcome_words = _EVENTS.get(f"{outcome} {claim.event}", f"runs with {outcome_words} {claim.event}")
    if claim.kind in ("spread", "range"):
        outcome_words = f"{claim.kind} of {outcome_words}"
    pair_names = claim.called[2:]
    if claim.kind == "interaction":
        return f"effect on {outcome_words}, {' against '.join(pair_names)}:"
    if claim.paired and pair_names:
        return f"{pair_names[claim.a.index(claim_contrast.a[0])]}, {outcome_words}"
    return outcome_words


def _outcome_words(outcome_name: str) -> str:
    if outcome_name.startswith("steps-to:"):
        return f"steps to {100 * float(outcome_name.removeprefix('steps-to:')):g} % of the monsters"
    return find_outcome(outcome_name).short or find_outcome(outcome_name).words


# --- Claims ----------------------------------------------------------------------------------------


def compared_text(claim: Claim) -> str:
    """Return what is compared, as 'tanh against ReLU'; the first alone if there is only a threshold."""
    a, b = claim.called[:2] or (" and ".join(claim.a), " and ".join(claim.b))
    return f"{a} against {b}" if b else a


def erratum(claim: Claim) -> str:
    """Return that a claim's list quotes the thesis wrongly; empty if it does not."""
    for wrong_words, words in ERRATA.items():
        if wrong_words in claim.quote:
            return f"Erratum: the list, which stays as registered, has “{wrong_words}”; the thesis “{words}”."
    return ""


def sentence(claim: Claim) -> str:
    """Return the thesis's sentence without the marks of TeX and Markdown."""
    quote = claim.quote
    for wrong_words, words in ERRATA.items():
        quote = quote.replace(wrong_words, words)
    plain_text = re.sub(r"\$\$.*?\$\$ *|_\{[^}]*\}|[*$]|\[\d+\]", "", quote)
    plain_text = re.sub(r"\\([a-z]+|\|) ?", lambda match: _SYMBOLS.get(match[1], match[1]), plain_text)
    plain_text = re.sub(r"_(\w)", lambda match: match[1].translate(_SUBSCRIPTS), plain_text)
    return re.sub(r" (?=[,.;)])", "", " ".join(plain_text.split()))


def short_sentence(claim: Claim) -> str:
    """Return the sentence with … where words are left out."""
    return claim.short or shorten(sentence(claim), LONGEST_SENTENCE, placeholder=" …")
