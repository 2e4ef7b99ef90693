"""Whether a claim is what it was when its runs were trained, by the history of its file.

    ClaimList, and the commits of each claim's runs → names of what changed since

Everything that decides a verdict counts: arms, seeds, steps, outcomes, direction, value, need, margins (the
registered ones, if margins were set anew), and the version of the judge's rules. Words do not. The file is
found by its title, wherever it was. Nothing is known of a file outside a git checkout, nor of a commit that
the checkout does not have, or at which there was no such list yet.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from pneuma.analysis.claims.claim_list import RULES, Claim, ClaimList, pick
from pneuma.analysis.claims.fixed_runs import claims_on, find_claim_runs
from pneuma.errors import UserError
from pneuma.store.index import RunIndex
from pneuma.store.provenance import SOURCE, file_at, line_at
from pneuma.study.spec import CLAIMS, Study

THE_CLAIM, RULES_KEY = "the claim itself", "rules"
HOW_MANY = ("seeds", "steps", "margin", RULES_KEY)
"""Changes that leave what is compared as it was."""
_OF_OUTCOME = ("kind", "above", "below", "value", "margin")
"""What another outcome changes with it."""
_PLAIN = ("study", "paired", "kind", "above", "below", "need", "direction")


def refuse_changed(index: RunIndex, study: Study) -> None:
    """Refuse claims on a study that were changed after their first run: they are not preregistered any more.

    Raises:
        UserError: naming a claim, what changed, and what to do instead.
    """
    for claims, claim in claims_on(study):
        runs = find_claim_runs(index, claims, claim, study.world)
        changed = changed_since(claims, claim, study.world, runs.commits)
        if changed:
            raise UserError(
                f"--preset {CLAIMS}: the claim {claim.name} was changed after its first run "
                f"({', '.join(changed)}), so more runs test nothing; another preset, or --seeds and --steps, "
                "trains them"
            )


def changed_since(
    claims: ClaimList, claim: Claim, world: str, commits: Iterable[str]
) -> tuple[str, ...] | None:
    """Return what of a claim was otherwise at commits; None if no commit has its list.

    `THE_CLAIM` stands for a claim that the list did not have yet.
    """
    text = claims.path.read_text(encoding="utf-8")
    title = next((line for line in text.splitlines() if line.startswith("title = ")), "[defaults]")
    now = _deciding_keys(text, claim.name, world)
    changed: list[str] | None = None
    for commit in commits:
        text_then = _text_at(claims.path, commit, title)
        if text_then is None:
            continue
        then = _deciding_keys(text_then, claim.name, world)
        if then is None or now is None:
            differences = [THE_CLAIM]
        else:
            keys = [key for key in now if now[key] != then[key]]
            differences = [key for key in keys if "outcome" not in keys or key not in _OF_OUTCOME]
        is_own = SOURCE in claims.path.resolve().parents
        if is_own and _rules_at(claims.path, commit) != RULES:
            differences.append(RULES_KEY)
        changed = list(dict.fromkeys([*(changed or []), *differences]))
    return None if changed is None else tuple(changed)


@cache
def _text_at(path: Path, commit: str, title: str) -> str | None:
    return file_at(path, commit, title)


@cache
def _rules_at(path: Path, commit: str) -> int | None:
    """Return the version of the judge's rules at a commit; None if it had none."""
    version = re.search(r"^RULES = (\d+)", line_at(path, commit, "RULES = ", "pneuma"))
    return int(version[1]) if version else None


@cache
def _parse(text: str) -> Mapping[str, Any]:
    """Return the contents of a file; none of one that is not TOML."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return {}


def _deciding_keys(text: str, name: str, world: str) -> Mapping[str, Any] | None:
    """Return what decides the verdict on a claim of a file in a world; None if the file has no such claim."""
    contents = _parse(text)
    try:
        own = contents["claims"][name]
        keys = {**contents.get("defaults", {}), **contents["claims"].get(own.get("like"), {}), **own}
    except (KeyError, AttributeError, TypeError):
        return None
    deciding: dict[str, Any] = {key: keys.get(key) for key in _PLAIN}
    deciding["need"] = keys.get("need", "one")
    deciding["paired"] = bool(keys.get("paired") and keys.get("b"))
    for key in ("a", "b", "outcome"):
        value = keys.get(key, [])
        deciding[key] = [value] if isinstance(value, str) else value
    outcomes = deciding["outcome"]
    deciding["value"] = {outcome: pick(keys.get("value"), outcome, world) for outcome in outcomes}
    deciding["margin"] = _margins(contents, keys, outcomes, world)
    first = keys.get("seeds_from", contents.get("list", {}).get("seeds_from", 0))
    seeds = {}
    for condition in (*deciding["a"], *deciding["b"]):
        given = keys.get("seeds")
        count = given.get(condition) if isinstance(given, dict) else given
        seeds[condition] = list(range(first, first + count)) if isinstance(count, int) else count
    deciding["seeds"], deciding["steps"] = seeds, keys.get("steps")
    return deciding


def _margins(
    contents: Mapping[str, Any], keys: Mapping[str, Any], outcomes: Iterable[str], world: str
) -> dict[str, float | None]:
    """Return the margin of each outcome that was registered before the runs."""
    tables = (
        keys.get("registered_margin"), contents.get("registered_margins"),
        keys.get("margin"), contents.get("margins"),
    )  # fmt: skip
    margins: dict[str, float | None] = {}
    for outcome in outcomes:
        of_list = "incidence" if keys.get("kind") == "incidence" else outcome
        numbers = [
            pick(tables[0], outcome, world), pick((tables[1] or {}).get(of_list), world),
            pick(tables[2], outcome, world), pick((tables[3] or {}).get(of_list), world),
        ]  # fmt: skip
        margins[outcome] = next((number for number in numbers if number is not None), None)
    return margins
