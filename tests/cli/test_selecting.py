"""The options that select runs, read from words and told in words."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from pneuma.cli.options import Selecting, selecting_words
from pneuma.study.plan import Selection


@pytest.mark.parametrize(
    ("selection", "words"),
    [
        (Selection(), ""),
        (Selection("claims", (0, 1, 2)), "--preset claims --seeds 3"),
        (Selection(seeds=(4,), steps=512, engine="sb3"), "--seeds 4, --steps 512 --engine sb3"),
        (Selection(conditions=("tanh", "relu")), "--condition tanh --condition relu"),
        (
            Selection(settings={"betas": [0.9, 0.9], "reward": "kills", "gradient_limit": "none"}),
            "--set betas=[0.9, 0.9] --set reward=kills --set gradient_limit=none",
        ),
    ],
)
def test_a_selection_is_told_in_the_words_that_make_it(selection: Selection, words: str) -> None:
    told = selecting_words(selection)
    assert " ".join(told) == words
    given: dict[str, list[str]] = {}
    for option, value in zip(told[::2], told[1::2], strict=True):
        given.setdefault(option, []).append(value)
    keys = ("preset", "seeds", "steps", "engine")
    one: dict[str, Any] = {key: next(iter(given.get(f"--{key}", [])), None) for key in keys}
    read = Selecting(**one, condition=given.get("--condition"), set_=given.get("--set")).read()
    assert (read or Selection(settings={})) == replace(selection, settings=selection.settings or {})
