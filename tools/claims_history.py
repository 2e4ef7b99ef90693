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

from pneuma.analysis.claims.claim_list import shipped_claims
from pneuma.analysis.claims.fixed_runs import find_claim_runs
from pneuma.analysis.claims.history import changed_in_checkout, record_key
from pneuma.store.index import RunIndex
from pneuma.store.store import Store
from pneuma.study.shipped import claims_history_file

ROOT = Path(__file__).parents[1]


def has_history() -> bool:
    """Return whether this is a checkout with its whole history."""
    words = ["git", "-C", str(ROOT), "rev-parse", "--is-shallow-repository"]
    return subprocess.run(words, check=False, capture_output=True, text=True).stdout.strip() == "false"


def written() -> str:
    """Return what the file should hold: by `record_key` what changed, or null if no commit has the list."""
    changes: dict[str, tuple[str, ...] | None] = {}
    with TemporaryDirectory() as folder:
        index = RunIndex(Store(Path(folder)))  # of the published runs alone
        for claims in shipped_claims():
            for claim in claims.claims.values():
                for world in claim.worlds:
                    runs = find_claim_runs(index, claims.studies[claim.study].in_world(world), claim)
                    facts = claims, claim, world, runs.commits
                    if runs.commits:
                        changes[record_key(*facts)] = changed_in_checkout(*facts)
    return json.dumps(changes, indent=1, sort_keys=True) + "\n"


if __name__ == "__main__":
    if not has_history():
        sys.exit("this clone lacks the history of the claims: git fetch --unshallow")
    claims_history_file().write_text(written(), encoding="utf-8")
