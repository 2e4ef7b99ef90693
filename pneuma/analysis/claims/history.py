"""Whether a claim is what it was when its runs were trained, by the history of its file.

    ClaimList, and the commits of each claim's runs → `Changes`: names of what changed since, and the rules

Everything that decides a verdict counts: conditions, seeds, steps, outcomes, direction, value, need, margins
(the registered ones, if margins were changed), and the version of the judge's rules, unless it is
`RULES_BEFORE`, by which claims can still be judged. Words do not count. The
file is found by its title, wherever it was. Nothing is known of a file outside a git checkout, or of a commit
that the checkout lacks, or at which there was no such list yet.

For the lists on the thesis and their published runs, `claims-history.json` contains the answers, because
neither an installed package nor a clone of depth 1 has a history. `python -m tools.claims_history` writes it.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from pneuma.analysis.claims.claim_list import RULES, RULES_BEFORE, Claim, ClaimList, claim_keys
from pneuma.analysis.claims.fixed_runs import find_claim_runs
from pneuma.analysis.claims.preset import claims_on
from pneuma.errors import Hint, UserError
from pneuma.schema import normalize
from pneuma.store.index import RunIndex
from pneuma.store.provenance import SOURCE, file_at, line_at
from pneuma.study.shipped import claims_history_file
from pneuma.study.spec import CLAIMS, Study

THE_CLAIM, RULES_KEY = "the claim itself", "rules"
AMOUNT_KEYS = ("seeds", "steps", "margin", RULES_KEY)
"""Changes that leave the comparison the same."""
DECIDING_KEYS = (
    "study", "preset", "kind", "above", "below", "need", "direction", "a", "b", "outcome", "steps",
)  # fmt: skip
OUTCOME_KEYS = ("kind", "above", "below", "value", "margin")
"""Keys that change with the outcome."""


class Changes(NamedTuple):
    """What has changed of a claim since its runs were trained.

    Attributes:
        changed: names of what differs; None if no commit is known to have its list. `THE_CLAIM` stands for a
            claim that the list did not have yet.
        rules: the version of the judge's rules by which it was registered; `RULES_BEFORE` if it is older.
    """

    changed: tuple[str, ...] | None
    rules: int = RULES


def refuse_changed(index: RunIndex, study: Study) -> None:
    """Refuse claims on a study that were changed after their first run: they are not preregistered any more.

    Raises:
        UserError: naming a claim, what changed, and what to do instead.
    """
    for claim_list, claim in claims_on(study):
        commits = find_claim_runs(index, study, claim).commits
        changed = find_changes(claim_list, claim, study.world, commits).changed
        if changed:
            raise UserError(
                Hint("preset", CLAIMS),
                f": the claim {claim.name} was changed after its first run ({', '.join(changed)}), "
                "so more runs prove nothing; use another preset, or other seeds or steps",
            )


def find_changes(claim_list: ClaimList, claim: Claim, world: str, commits: Sequence[str]) -> Changes:
    """Return what has changed of a claim since commits, by the package's record or else by the checkout."""
    recorded, claim_key = _recorded(), record_key(claim_list, claim, world, commits)
    if claim_key not in recorded:
        return changes_in_checkout(claim_list, claim, world, commits)
    return Changes(**recorded[claim_key])


def record_key(claim_list: ClaimList, claim: Claim, world: str, commits: Sequence[str]) -> str:
    """Return all that `find_changes` depends on: the list, the judge's rules, and the runs."""
    return " ".join([claim.name, world, claim_list.digest, f"rules={RULES}"] + list(commits))


@cache
def _recorded() -> Mapping[str, dict[str, Any]]:
    """Return the fields of `Changes` by `record_key`."""
    recorded: Mapping[str, dict[str, Any]] = normalize(
        json.loads(claims_history_file().read_text(encoding="utf-8"))
    )
    return recorded


def changes_in_checkout(claim_list: ClaimList, claim: Claim, world: str, commits: Sequence[str]) -> Changes:
    """Return the same by the history of the checkout that the list is in."""
    file_text = claim_list.path.read_text(encoding="utf-8")
    (title,) = re.findall("^title = .*", file_text, flags=re.MULTILINE)[:1] or ["[defaults]"]
    keys_now = _deciding_keys(file_text, claim.name, world)
    is_own = SOURCE in claim_list.path.resolve().parents
    changed: list[str] = []
    is_known = False
    rules = RULES
    for commit in commits:
        text_then = file_at(claim_list.path, commit, title)
        if text_then is None:
            continue
        is_known = True
        keys_then = _deciding_keys(text_then, claim.name, world)
        if not keys_then:
            changed.append(THE_CLAIM)
        has_outcome = keys_then.get("outcome") == keys_now["outcome"]
        for claim_key, value in keys_then.items():
            if value != keys_now[claim_key] and (has_outcome or claim_key not in OUTCOME_KEYS):
                changed.append(claim_key)
        rules_then = _rules_at(claim_list.path, commit) if is_own else RULES
        if rules_then != RULES:
            rules = RULES_BEFORE
        if rules_then not in (RULES, RULES_BEFORE):
            changed.append(RULES_KEY)
    if not is_known:
        return Changes(None)
    return Changes(tuple(dict.fromkeys(changed)), rules)


@cache
def _rules_at(path: Path, commit: str) -> int | None:
    """Return the version of the judge's rules at a commit; None if it had none."""
    version = re.match(r"RULES = (\d+)", line_at(path, commit, "RULES = ", "pneuma"))
    if version is None:
        return None
    return int(version[1])


@cache
def _parse(file_text: str) -> Mapping[str, Any]:
    return normalize(tomllib.loads(file_text))


def _deciding_keys(file_text: str, claim_name: str, world: str) -> Mapping[str, Any]:
    """Return what decides the verdict on a claim of a file in a world; nothing if the file has no such claim.

    The file may be of another version, whose keys are not checked.
    """
    try:
        claim = Claim.model_construct(
            **{"seeds": (), "steps": 0, **claim_keys(_parse(file_text), claim_name)}
        )
        deciding = {claim_key: getattr(claim, claim_key) for claim_key in DECIDING_KEYS}
        deciding["paired"] = claim.paired and bool(claim.b)
        deciding["value"] = list(map(partial(claim.value_of, world), claim.outcome))
        deciding["margin"] = list(map(partial(claim.registered_margin_of, world), claim.outcome))
        deciding["seeds"] = list(map(claim.seeds_of, claim.a + claim.b))
        return deciding
    except (ValueError, LookupError, AttributeError, TypeError):
        return {}
