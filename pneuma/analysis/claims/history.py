"""Whether a claim fixes what it fixed when its runs were trained, by the history of its file.

    ClaimList, and the commits of each claim's runs → names of the keys that changed since

Only what decides which numbers are compared counts: arms, seeds, steps, outcomes. Words and margins do not.
The file is known by its title, wherever it was. Nothing can be said of a file outside a git checkout, nor of
a commit that the checkout does not have.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from pneuma.analysis.claims.claim_list import ClaimList
from pneuma.study.provenance import file_at

FIXED = (
    "study", "a", "b", "paired", "seeds", "seeds_from", "steps", "outcome", "kind", "above", "below",
)  # fmt: skip
ABSENT = "the claim itself"


def changed_since(claims: ClaimList, name: str, commits: Iterable[str]) -> list[str]:
    """Return the keys of a claim that its file had otherwise at a commit; `ABSENT` if there was no claim."""
    found: dict[str, None] = {}
    text = claims.path.read_text(encoding="utf-8")
    title = next((line for line in text.splitlines() if line.startswith("title = ")), "[defaults]")
    for commit in commits:
        if (then := _fixed_at(claims.path, commit, title)) is not None:
            now = _fixed_in(text)[name]
            if name not in then:
                found[ABSENT] = None
            else:
                found |= dict.fromkeys(key for key in FIXED if _differ(now[key], then[name][key]))
    return [*found]


def _differ(now: Any, then: Any) -> bool:
    """Return whether values differ; seeds and steps do in conditions that both have."""
    if isinstance(now, dict) and isinstance(then, dict):
        return any(now[name] != then[name] for name in {*now} & {*then})
    return bool(now != then)


@cache
def _fixed_at(path: Path, commit: str, title: str) -> Mapping[str, Mapping[str, Any]] | None:
    text = file_at(path, commit, title)
    return None if text is None else _fixed_in(text)


@cache
def _fixed_in(text: str) -> Mapping[str, Mapping[str, Any]]:
    """Return what each claim of a file fixes, as it is written there; nothing of a file that is no TOML."""
    try:
        said = tomllib.loads(text)
        usual, claims = said.get("defaults", {}), said.get("claims", {})
        first = {"seeds_from": said.get("list", {}).get("seeds_from", 0)}
        return {
            name: _listed({**first, **usual, **claims.get(own.get("like"), {}), **own})
            for name, own in claims.items()
        }
    except (tomllib.TOMLDecodeError, AttributeError, TypeError):
        return {}


def _listed(claim: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys that count; "x" is ["x"]; seeds and steps are by condition of a and b."""
    values = {key: claim.get(key) for key in FIXED}
    values = {key: [value] if isinstance(value, str) else value for key, value in values.items()}
    for key in ("seeds", "steps"):
        of = values[key]
        arms = [*(values["a"] or ()), *(values["b"] or ())]
        values[key] = {name: of.get(name) if isinstance(of, dict) else of for name in arms}
    return values
