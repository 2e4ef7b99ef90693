"""Write what changed of the thesis's claims since their first runs, as the history of this checkout says.

    python -m tools.claims_history        # writes results/published/claims-history.json

An installed package and a clone of depth 1 have no history, so the answers come with the published runs.
`tests/analysis/test_claim_history.py` compares them with the history, where a checkout has it.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pneuma.analysis.claims.claim_list import RULES_BEFORE, shipped_claims
from pneuma.analysis.claims.fixed_runs import find_claim_runs
from pneuma.analysis.claims.history import changes_in_checkout, record_key
from pneuma.store.index import RunIndex
from pneuma.store.store import Store
from pneuma.study.shipped import claims_history_file

ROOT = Path(__file__).parents[1]


def has_history() -> bool:
    """Return whether this is a checkout with its whole history."""
    words = ["git", "-C", str(ROOT), "rev-parse", "--is-shallow-repository"]
    return subprocess.run(words, check=False, capture_output=True, text=True).stdout.strip() == "false"


def written() -> str:
    """Return what the file should hold: by `record_key` what changed, or null if no commit has the list.

    The commits that this repository lacks are older than the versions of the judge's rules.
    """
    recorded: dict[str, dict[str, Any]] = {}
    with TemporaryDirectory() as folder:
        index = RunIndex(Store(Path(folder)))  # of the published runs alone
        for claims in shipped_claims():
            for claim in claims.claims.values():
                for world in claim.worlds:
                    runs = find_claim_runs(index, claims.studies[claim.study].in_world(world), claim)
                    facts = claims, claim, world, runs.commits
                    if runs.commits:
                        changes = changes_in_checkout(*facts)
                        rules = RULES_BEFORE if changes.changed is None else changes.rules
                        recorded[record_key(*facts)] = {"changed": changes.changed, "rules": rules}
    return json.dumps(recorded, indent=1, sort_keys=True) + "\n"


if __name__ == "__main__":
    if not has_history():
        sys.exit("this clone lacks the history of the claims: git fetch --unshallow")
    claims_history_file().write_text(written(), encoding="utf-8")
