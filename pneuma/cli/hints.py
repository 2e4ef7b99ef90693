"""How the command line writes the arguments that messages name: as options, and calls as commands."""

from __future__ import annotations

import shlex
from typing import Any

from pneuma.errors import printable
from pneuma.seeds import seeds_option
from pneuma.study.command_words import results_words, study_words
from pneuma.study.plan import Plan, default_preset

OPTIONS = {
    "conditions": "--condition", "settings": "--set", "outcomes": "--outcome", "formats": "--format",
    "values": "--value",
}  # fmt: skip
"""The options that are not called as arguments in Python."""
VERBS = {"run_study": "run", "plot": "plot", "summarize": "summary"}
"""The commands that are not called as functions in Python."""


def command(*words: object) -> str:
    return printable(shlex.join(["pneuma"] + list(map(str, words))))


def query_words(plan: Plan) -> list[str]:
    """Return the words of a command that name a plan's study and query."""
    query, words = plan.query, study_words(plan.study)
    if plan.preset != default_preset(plan.study):
        words += ["--preset", plan.preset]
    for condition in query.conditions:
        words += ["--condition", condition]
    if query.seeds is not None:
        words += ["--seeds", seeds_option(query.seeds)]
    if query.steps:
        words += ["--steps", str(query.steps)]
    return words


def write_hint(hint: Any) -> str:
    """Return a `Hint` as an option, or a `StudyCall` as a command."""
    if hint.field in VERBS:
        words = query_words(hint.plan) if hint.plan else [hint.value]
        if hint.unpublished:
            words.append("--unpublished")
        if hint.results is not None:
            words += results_words(hint.results)
        return command("study", VERBS[hint.field], *words)
    option_name = OPTIONS.get(hint.field, f"--{hint.field.replace('_', '-')}")
    if hint.value is None or hint.value is True:
        return option_name
    return f"{option_name} {shlex.quote(str(hint.value))}"
