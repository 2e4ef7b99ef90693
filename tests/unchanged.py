"""What a rewrite must not move, as checksums: `python -m tests.unchanged` compares, `--record` writes them.

Run ids of every condition of every shipped study in each world; every table that `study export` makes of what
each committed published table answers; the verdicts of `study verify` on them. Nothing is trained, as the last
bits of a training depend on the processor. Golden traces of rules and engines are tests of their own.
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path

from pneuma.analysis.run_index import RunIndex
from pneuma.errors import UserError
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import list_studies, load_study
from pneuma.study.store import Store

from .cli.calls import call, described

RECORD = Path(__file__).with_name("unchanged.json")
WORLDS = ("text", "godot", "arena")
TABLES = ("evaluations", "curves", "summary")
PUBLISHED = Path(__file__).parent.parent / "results"


def compare() -> int:
    """Compare with the record, or write it; return 1 where anything differs."""
    found = {"run ids": _run_ids(), "tables": _tables(), "verdicts": _verdicts()}
    if "--record" in sys.argv:
        RECORD.write_text(json.dumps(found, indent=1) + "\n")
        return 0
    known = json.loads(RECORD.read_text())
    wrong = [
        f"{kind}: {name}"
        for kind in known
        for name in {**known[kind], **found[kind]}
        if known[kind].get(name) != found[kind].get(name)
    ]
    print("\n".join(wrong) or "unchanged")
    return 1 if wrong else 0


def _run_ids() -> dict[str, str]:
    ids = {}
    for study in list_studies():
        for world in WORLDS:
            for preset in ("quick", "paper"):
                try:
                    plan = make_plan(load_study(study, world), Selection(preset=preset))
                except UserError:  # it has no such world or preset
                    continue
                runs = [[cell.condition, cell.run.seed, cell.run_id] for cell in plan.cells]
                ids[f"{study} {world} {preset}"] = _digest(json.dumps(sorted(runs)))
    return ids


def _tables() -> dict[str, str]:
    """Digest what readers make of the published tables."""
    found = {}
    for name, published in RunIndex(Store(PUBLISHED), stored=False, shipped=False).tables.items():
        about = published.about
        settings = [word for key, value in about["settings"].items() for word in ("--set", f"{key}={value}")]
        world = ("--world", about["world"]) if about["world"] else ()
        for table in TABLES:
            at = (*world, *settings, "--results", str(PUBLISHED))
            code, out, _ = call("study", "export", about["study"], "--table", table, "--out", "-", *at)
            found[f"{name} {table}"] = "refused" if code else _digest(out)
    return found


def _verdicts() -> dict[str, str]:
    told = described("study", "verify", "--json", "--results", PUBLISHED)
    return {"published": _digest(json.dumps(told["claims"], sort_keys=True))}


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


if __name__ == "__main__":
    sys.exit(compare())
