"""What the tests of the report share: a report made by hand, and a real browser."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from pneuma.figures.report import Report
from pneuma.figures.report_html import Picture
from pneuma.figures.report_studies import Conditions, Origin, Part, RunRow, StudySection
from pneuma.figures.report_verdicts import Claim, Effect, Verdict

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
QUIET = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars"),
)
TINY_PICTURE = b'<svg xmlns="http://www.w3.org/2000/svg" width="700" height="300"><path d="M0 0h9"/></svg>'


def _run_id(number: int) -> str:
    return f"{number:016x}"


def _part(record: str, world: str, first: int) -> Part:
    names = ("tanh", "relu")
    runs = [RunRow(name, seed, _run_id(first + 2 * seed + k), "done", "batched")
            for seed in range(3) for k, name in enumerate(names)]  # fmt: skip
    number = {"statistic": "mean", "value": 0.25, "low": 0.125, "high": 0.5, "interval": "95 % t", "runs": 3}
    outcomes = [{"condition": name, "outcome": f"outcome {k}"} for name in names for k in range(6)]
    summary = pd.DataFrame([{**outcome, **number} for outcome in outcomes])
    return Part(
        record,
        world,
        extent="2 conditions, 3 seeds, 50,176 agent steps a run",
        pictures=(Picture(TINY_PICTURE, "svg", "Two lines, one above the other.", "Drawn."),),
        summary=summary,
        conditions=Conditions(
            "table-6-2",
            names,
            {"activation": ("tanh", "tanh", "relu")},
            {"gradient_limit": ("0.5", "none")},
            {f"setting_{k}": str(k) for k in range(40)},
        ),
        runs=tuple(runs),
        origins=(Origin({"packages": "torch 2.13.0, numpy 2.4.6", "cpu": "A processor"}, 6),),
    )


@pytest.fixture(scope="session")
def example() -> Report:
    """A report with every kind of thing in it: two claims, a study in two worlds, one without runs."""
    quote = "tanh both improves performance, and decreases variance"
    killed = Effect("tanh against relu", "supported", 0.12, (0.05, 0.19), (10, 10), 0.004)
    none = Effect("tanh against relu", "refuted", -0.001, (-0.02, 0.02), (10, 10), 0.0001)
    ratio = Effect("tanh against relu", "inconclusive", 1.3, (0.7, 2.4), (3, 3), 0.5, ratio=True)
    ids = (_run_id(16), _run_id(17), _run_id(9999))
    verdicts = {
        "text": Verdict(
            "supported", "", (killed, replace(killed, arms="tanh against leaky-relu")), None, ids
        ),
        "godot": Verdict("refuted", "", (none,)),
        "logs": Verdict("untestable", "One run an arm."),
    }
    spread = {"text": Verdict("inconclusive", "", (ratio,), 33)}
    return Report(
        claims=(
            Claim("6.2-tanh-better", quote, "6.2", "activation", "share killed", verdicts),
            Claim("6.2-tanh-steadier", quote, "6.2", "activation", "", spread),
            Claim("6-small-best", "the small network performs best", "6", "sizes"),
        ),
        studies=(
            StudySection(
                "activation",
                "Activation function",
                "6.2",
                "What differs, and why.",
                (
                    _part("activation", "In the text's world", 16),
                    _part("activation-godot", "In the published code's world", 64),
                ),
            ),
            StudySection(
                "optimizer",
                "Optimizer",
                "6.1",
                "",
                (Part("optimizer", "In the text's world", ("No runs yet.",), "pneuma study run x"),),
            ),
        ),
        claims_note="claims.toml, sha256 0123456789abcdef",
        version="0.1.0",
    )


# --- The browser -----------------------------------------------------------------------------------


class Browser:
    """A headless Chromium, started afresh for every question."""

    def __init__(self, path: str, folder: Path) -> None:
        self._path, self._folder, self._count = path, folder, 0

    def _ask(self, page: Path, *options: str, dark: bool = False) -> str:
        self._count += 1
        profile = self._folder / f"profile-{self._count}"
        command = [self._path, *QUIET, f"--user-data-dir={profile}"]
        command += [f"--blink-settings=preferredColorScheme={0 if dark else 1}", *options, page.as_uri()]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        shutil.rmtree(profile, ignore_errors=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def screenshot(self, page: Path, to: Path, size: tuple[int, int], dark: bool = False) -> bytes:
        """Return what the page looks like, as a PNG."""
        self._ask(page, f"--screenshot={to}", f"--window-size={size[0]},{size[1]}", dark=dark)
        return to.read_bytes()

    def evaluate(
        self, page: Path, script: str, widths: Sequence[int] = (1280,), dark: bool = False
    ) -> list[str]:
        """Return what a script finds in a page that is shown so wide: in frames, which no window limits.

        The script is put before the page's policy, which would forbid it.
        """
        told = f"addEventListener('load', () => parent.postMessage([innerWidth, String({script})], '*'))"
        source = page.read_text(encoding="utf-8").replace("<head>", f"<head><script>{told}</script>", 1)
        (self._folder / "asked.html").write_text(source, encoding="utf-8")
        frame = self._folder / "frame.html"
        frame.write_text(
            "<!DOCTYPE html><pre></pre><script>const found = {}; addEventListener('message', event => { "
            "found[event.data[0]] = event.data[1]; "
            "document.querySelector('pre').textContent = JSON.stringify(found); })</script>"
            + "".join(
                f'<iframe src="asked.html" width="{width}" height="800" style="border: 0"></iframe>'
                for width in widths
            )
        )
        budget = ("--virtual-time-budget=10000", "--window-size=1800,1000", "--dump-dom")
        dumped = re.search("<pre>(.*?)</pre>", self._ask(frame, *budget, dark=dark), re.DOTALL)
        assert dumped
        found = json.loads(html.unescape(dumped[1]))
        return [found[str(width)] for width in widths]


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A real browser, or a skip that says how to get one."""
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        pytest.skip("no Chromium here: install it (Debian: apt-get install chromium) to test the page in it")
    yield Browser(path, tmp_path_factory.mktemp("browser"))
