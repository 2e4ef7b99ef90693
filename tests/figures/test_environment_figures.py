"""The environment's own figures: the thesis's 2.1, 5.1, 5.2 and 6.1, drawn from the state alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.figures import environment


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Draw all of them once."""
    folder = tmp_path_factory.mktemp("figures")
    for draw in (environment.draw_mailman, environment.draw_level, environment.draw_screens):
        draw(folder)
    return folder


def test_drawing_twice_gives_the_same_bytes(drawn: Path, tmp_path: Path) -> None:
    names = {"fig-2-1.png", "fig-2-1.svg", "fig-5-1.png", "fig-5-2.png", "fig-6-1.png"}
    assert {path.name for path in drawn.iterdir()} == names
    for draw in (environment.draw_mailman, environment.draw_level, environment.draw_screens):
        for path in draw(tmp_path):
            assert path.read_bytes() == (drawn / path.name).read_bytes()
