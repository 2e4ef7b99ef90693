"""The report in a real browser: it fits, it is light or dark as wished, and its words can be read."""

from __future__ import annotations

import json
import re
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

from pneuma.figures.report import Report, report_page

STYLE = files("pneuma.figures").joinpath("report.css").read_text(encoding="utf-8")
PAIRS = [
    *((word, ground) for word in ("text", "muted", "link") for ground in ("ground", "card")),
    *((word, f"{word}-ground") for word in ("supported", "refuted", "inconclusive", "untestable")),
]


MEASURED = """JSON.stringify({
    whole: [document.documentElement.scrollWidth, document.documentElement.clientWidth],
    boxes: [...document.querySelectorAll('.scroll')].map(e => [e.scrollWidth > e.clientWidth, e.tabIndex]),
    pictures: [...document.images].map(image => [image.complete, image.naturalWidth, image.clientWidth]),
    asked: performance.getEntriesByType('resource').filter(each => !each.name.startsWith('data:')).length,
    ground: getComputedStyle(document.body).backgroundColor,
})"""
WIDTHS = (320, 768, 1600)


@pytest.fixture(scope="module")
def page(example: Report, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_bytes(report_page(example))
    return path


@pytest.fixture(scope="module")
def measured(page: Path, browser: Any) -> dict[int, Any]:
    """What the page measures, by its width."""
    return dict(zip(WIDTHS, map(json.loads, browser.evaluate(page, MEASURED, WIDTHS)), strict=True))


@pytest.mark.parametrize("width", WIDTHS)
def test_the_page_never_scrolls_sideways(width: int, measured: dict[int, Any]) -> None:
    assert measured[width]["whole"] == [width, width]


def test_a_wide_table_scrolls_in_a_box_that_the_keyboard_reaches(measured: dict[int, Any]) -> None:
    assert [True, 0] in measured[320]["boxes"]
    assert all(tab == 0 for _, tab in measured[320]["boxes"])


def test_pictures_are_decoded_and_never_too_small_to_read(measured: dict[int, Any]) -> None:
    shown = [width for each in measured.values() for _, _, width in each["pictures"]]
    assert len(shown) == 6
    assert all(540 <= width <= 800 for width in shown)
    assert all(done and natural == 700 for done, natural, _ in measured[320]["pictures"])


def test_the_browser_asks_for_nothing(measured: dict[int, Any]) -> None:
    assert [each["asked"] for each in measured.values()] == [0, 0, 0]


def test_light_and_dark_look_different(
    page: Path, measured: dict[int, Any], browser: Any, tmp_path: Path
) -> None:
    looks = [browser.screenshot(page, tmp_path / f"{dark}.png", (800, 600), dark) for dark in (False, True)]
    assert looks[0] != looks[1]
    assert measured[768]["ground"] == "rgb(255, 255, 255)"
    (dark,) = browser.evaluate(page, MEASURED, dark=True)
    assert json.loads(dark)["ground"] == "rgb(20, 23, 26)"


# --- Contrast, computed ----------------------------------------------------------------------------


def _colours(dark: bool) -> dict[str, str]:
    """Return the page's colours by name, as the style sheet states them first for light, then for dark."""
    block = re.findall(r":root \{(.*?)\}", STYLE, re.DOTALL)[1 if dark else 0]
    return dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", block))


def _luminance(colour: str) -> float:
    """Return the relative luminance of a colour (WCAG 2.2)."""
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _contrast(one: str, other: str) -> float:
    low, high = sorted([_luminance(one), _luminance(other)])
    return (high + 0.05) / (low + 0.05)


def test_contrast_is_computed_rightly() -> None:
    assert _contrast("#000000", "#ffffff") == pytest.approx(21)
    assert _contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)  # a well-known miss


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("pair", PAIRS)
def test_words_stand_out_from_their_ground(pair: tuple[str, str], dark: bool) -> None:
    colours = _colours(dark)
    assert _contrast(*(colours[name] for name in pair)) >= 4.5
