"""What a rewrite must not move, as checksums: `python -m tests.unchanged` compares, `--record` writes them.

Run ids of every condition of every shipped study in each world; of two small studies that are trained,
published and taken away, every table that `study export` makes and the verdicts of `study verify`. Golden
traces of rules and engines are tests of their own.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

RECORD = Path(__file__).with_name("unchanged.json")
WORLDS = ("text", "godot", "arena")
TABLES = ("episodes", "metrics", "evaluations", "curves", "summary")
TINY = (
    "--seeds", "2", "--steps", "2048", "--set", "actor=[8]", "--set", "critic=[8]",
    "--set", "evaluation_episodes=2",
)  # fmt: skip


def main() -> int:
    """Compare with the record, or write it; return 1 where anything differs."""
    found = {"run ids": _run_ids(), **_tables()}
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
    for study in sorted(path.stem for path in Path("studies").glob("*.toml") if path.stem != "claims"):
        for world in WORLDS:
            for preset in ("quick", "paper"):
                words = (
                    "study",
                    "plan",
                    study,
                    "--world",
                    world,
                    "--preset",
                    preset,
                    "--json",
                )
                done = _pneuma(*words)
                if done.returncode == 0:
                    runs = [
                        [run["condition"], run["seed"], run["run_id"]]
                        for run in json.loads(done.stdout)["runs"]
                    ]
                    ids[f"{study} {world} {preset}"] = _digest(json.dumps(sorted(runs)))
    return ids


def _tables() -> dict[str, dict[str, str]]:
    """Train two small studies, and digest what the readers make of them, stored and published."""
    tables: dict[str, str] = {}
    verdicts = {}
    with tempfile.TemporaryDirectory() as folder:
        at = ("--results", folder)
        for study, world in (("activation", "arena"), ("optimizer", "godot")):
            _done("study", "run", study, "--world", world, *TINY, "--quiet", *at)
            tables |= {f"{key}, stored": value for key, value in _exports(study, world, at).items()}
            _done("study", "publish", study, "--world", world, *at)
        verdicts["stored"] = _verdicts(at)
        subprocess.run(["rm", "-rf", f"{folder}/runs"], check=True)
        for study, world in (("activation", "arena"), ("optimizer", "godot")):
            tables |= {f"{key}, published": value for key, value in _exports(study, world, at).items()}
        verdicts["published"] = _verdicts(at)
    return {"tables": tables, "verdicts": verdicts}


def _exports(study: str, world: str, at: tuple[str, ...]) -> dict[str, str]:
    found = {}
    for table in TABLES:
        done = _pneuma("study", "export", study, "--world", world, "--table", table, "--out", "-", *at)
        found[f"{study} {world} {table}"] = _digest(done.stdout) if done.returncode == 0 else "refused"
    return found


def _verdicts(at: tuple[str, ...]) -> str:
    return _digest(
        json.dumps(json.loads(_done("study", "verify", "--json", *at).stdout)["claims"], sort_keys=True)
    )


def _done(*words: str) -> Any:
    done = _pneuma(*words)
    assert done.returncode == 0, done.stderr
    return done


def _pneuma(*words: str) -> Any:
    return subprocess.run(
        [sys.executable, "-m", "pneuma", *words], capture_output=True, text=True,
        env={**os.environ, "PNEUMA_RESULTS": "nowhere"},
    )  # fmt: skip


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


if __name__ == "__main__":
    sys.exit(main())
