"""The options that select runs, read from words and told in words."""

from __future__ import annotations

import pytest
import typer

from pneuma.cli.options import Chosen, grouped, selecting_words
from pneuma.study.plan import Selection


@pytest.mark.parametrize(
    ("selection", "words"),
    [
        (Selection(settings={}), ""),
        (Selection("claims", (0, 1, 2), settings={}), "--preset claims --seeds 3"),
        (Selection(seeds=(4,), steps=512, engine="sb3", settings={}), "--seeds 4, --steps 512 --engine sb3"),
        (Selection(conditions=("tanh", "relu"), settings={}), "--condition tanh --condition relu"),
        (
            Selection(settings={"betas": [0.9, 0.9], "reward": "kills", "gradient_limit": "none"}),
            "--set betas=[0.9, 0.9] --set reward=kills --set gradient_limit=none",
        ),
    ],
)
def test_a_selection_is_told_in_the_words_that_make_it(selection: Selection, words: str) -> None:
    told, app, read = selecting_words(selection), typer.Typer(), []

    @app.command()
    @grouped
    def take(chosen: Chosen) -> None:
        read.append(chosen.selection)

    assert " ".join(told) == words
    app(told, standalone_mode=False)
    assert read == [selection]
