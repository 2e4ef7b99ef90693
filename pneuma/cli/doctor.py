"""`pneuma doctor`: what is installed, whether it works, and what to do where it does not."""

from __future__ import annotations

from pathlib import Path

import typer

from pneuma.cli.options import Json, Results, print_json
from pneuma.cli.plain_text import plain

RESULTS = Path("results")
SIGNS = {"good": "ok", "note": "note", "broken": "BROKEN"}


def doctor(results: Results = RESULTS, json: Json = False) -> None:
    """Say what is installed here and whether it works, with the mend for what does not."""
    from pneuma.doctor import as_document, examine

    findings = []
    for finding in examine(results):
        findings.append(finding)
        if not json:
            print(f"{SIGNS[finding.state]:<7} {finding.check:<19} {plain(finding.told)}", flush=True)
            if finding.mend:
                print(f"{'':<7} {'':<19} -> {plain(finding.mend)}", flush=True)
    document = as_document(findings)
    if json:
        print_json(document)
    else:
        print(_closing(document["ok"]))
    if not document["ok"]:
        raise typer.Exit(1)


def _closing(ok: bool) -> str:
    if ok:
        return "\nAll that Pneuma needs is here. Begin with: pneuma study run activation"
    return "\nSomething that Pneuma needs is broken: mend what is marked above, then ask again."
