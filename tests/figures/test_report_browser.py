"""The report in a real browser."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from .test_report import _page

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
QUIET = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars"),
)
WIDTHS = (320, 768, 1600)
MEASURED = """JSON.stringify({
    whole: [document.documentElement.scrollWidth, document.documentElement.clientWidth],
    boxes: [...document.querySelectorAll('.scroll')].map(e => [e.scrollWidth > e.clientWidth, e.tabIndex]),
    pictures: [...document.images].map(image => image.complete && image.naturalWidth),
    asked: performance.getEntriesByType('resource').filter(each => !each.name.startsWith('data:')).length,
})"""


def test_a_browser_opens_it_at_any_width_and_asks_for_nothing(tmp_path: Path) -> None:
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip("no Chromium here: install it (Debian: apt-get install chromium) to test the page in it")
    measured = _measure(browser, tmp_path, _page().decode())
    for width, found in measured.items():
        assert found["whole"] == [int(width), int(width)]  # the page itself never scrolls sideways
        assert found["pictures"] == [700]
        assert found["asked"] == 0
    assert [True, 0] in measured["320"]["boxes"]  # a wide table does, in a box that the keyboard reaches


def _measure(browser: str, folder: Path, page: str) -> dict[str, Any]:
    """Return what the page measures by its width: in frames, which no window limits.

    The script is put before the page's policy, which would forbid it.
    """
    told = f"addEventListener('load', () => parent.postMessage([innerWidth, {MEASURED}], '*'))"
    (folder / "asked.html").write_text(page.replace("<head>", f"<head><script>{told}</script>", 1))
    (folder / "frame.html").write_text(
        "<!DOCTYPE html><pre></pre><script>const found = {}; addEventListener('message', event => { "
        "found[event.data[0]] = JSON.parse(event.data[1]); "
        "document.querySelector('pre').textContent = JSON.stringify(found); })</script>"
        + "".join(f'<iframe src="asked.html" width="{width}" style="border: 0"></iframe>' for width in WIDTHS)
    )
    options = (f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=10000", "--dump-dom")
    command = [browser, *QUIET, *options, "--window-size=1800,1000", (folder / "frame.html").as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    found = re.search("<pre>(.*?)</pre>", done.stdout, re.DOTALL)
    assert done.returncode == 0 and found, done.stderr
    measured: dict[str, Any] = json.loads(html.unescape(found[1]))
    assert [*measured] == [str(width) for width in WIDTHS]
    return measured
