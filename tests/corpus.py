"""What reading commands give, for comparison before and after a change that must not be noticed.

    python -m tests.corpus --record FOLDER    run them, and keep what each printed, and its figures' files
    python -m tests.corpus --compare FOLDER   run them again; print those that differ, and how the first does

The commands are every one that reads, in every form that it has, over published studies, studies of several
environments, imported logs and searches. FOLDER is outside the repository: what is in it depends on versions
of packages.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import os
import shlex
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from .cli.calls import call
from .cli.test_environments import save_two_environments
from .hand_made import write_events

FORMATS = ("table", "markdown", "latex", "csv", "json")
IN_EVERY_FORMAT = (
    "study summary activation",
    "study summary cartpole",
    "study summary two.toml",
    "study summary old",
    "study compare activation tanh relu",
    "study compare activation --with early",
    "study compare cartpole activation Adam",
    "study compare two.toml ppo a2c",
    "study compare old tanh relu",
    "study status activation",
    "study verify tanh-better",
    "study table",
)
AS_TABLE_AND_JSON = (
    "study summary late-collapse --outcome final-share-killed --outcome collapsed",
    "study summary activation --world godot",
    "study summary generalisation",
    "study summary published-logs",
    "study compare activation tanh relu --world text --outcome late-share-killed",
    "study collapse late-collapse",
    "study collapse two.toml",
    "study collapse old",
    "study status two.toml",
    "study status old --runs",
    "study show activation",
    "study show two.toml",
    "study plan activation --preset quick",
    "study plan activation --detect 0.05",
    "study verify --design",
    "study verify default-adam-collapses --world godot",
    "study list",
    "search list",
    "search show ppo",
    "search status ppo",
    "run list",
    "env list",
)
IN_ONE_FORM = (
    "study summary activation --format markdown --cells interval",
    "study summary activation --cells sd",
    "study summary activation --outcome nothing",
    "study compare activation",
    "study compare activation tanh sigmoid",
    "study compare tuned --with activation --world text",
    "study compare activation tanh tanh",
    "study verify no-such-claim",
    *(
        f"study export {study} --table {table} --out -"
        for study in ("cartpole", "two.toml")
        for table in ("evaluations", "curves", "summary")
    ),
    "study export old --table curves --band ci --out -",
    "study plot activation --out figures --format svg",
    "study plot activation --figure summary --out figures/summary.svg",
    "study plot activation --quantity entropy --band ci --beside optimizer --out figures/beside.png",
    "study plot activation --figure one-action --world godot --out figures/one-action.svg --json",
    "study plot two.toml --out figures/two.svg",
    "study plot two.toml --figure summary --out figures/two-summary.svg",
    "study plot two.toml --figure profile --out figures/two-profile.svg",
    "study plot cartpole --figure factors --out figures/factors.svg",
    "study plot old --out figures/old.svg",
    "search plot ppo --out figures --format svg",
    "report cartpole --out report.html",
)


def commands() -> Iterator[str]:
    for command in IN_EVERY_FORMAT:
        yield from (f"{command} --format {output_format}" for output_format in FORMATS)
    for command in AS_TABLE_AND_JSON:
        yield from (command, f"{command} --json")
    yield from IN_ONE_FORM


def prepare() -> None:
    """Fill the working folder with a study of two environments and imported logs, neither of them trained."""
    save_two_environments(Path("two.toml"))
    for number, name in enumerate(("tanh_1", "tanh_2", "relu_1", "relu_2")):
        points = [("rollout/ep_rew_mean", 100 * k, k + number / 4) for k in range(1, 11)]
        write_events(Path("old") / name / "events.out.tfevents.1700000000.host", points)
    call("import", "tensorboard", "old")


def write_outputs(folder: Path) -> None:
    """Run the commands in a folder of their own, and write a file for each into another."""
    with tempfile.TemporaryDirectory() as scratch, contextlib.chdir(scratch):
        prepare()
        for command in commands():
            code, out, err = call(*shlex.split(command))
            text = f"exit code {code}\n{out}{err}".replace(str(Path(scratch).resolve()), "SCRATCH")
            (folder / f"{command.replace('/', '_')}.txt").write_text(text, encoding="utf-8")
        for path in (*Path("figures").iterdir(), *Path().glob("*.html")):
            shutil.copy(path, folder)


def differences(folder: Path, recorded: Path) -> list[str]:
    """Return which files of two folders differ, and lines of the first that does."""
    names = {path.name for path in (*folder.iterdir(), *recorded.iterdir())}
    lines: list[str] = []
    for name in sorted(names):
        before, now = _contents(recorded / name), _contents(folder / name)
        if before == now:
            continue
        if not lines:
            texts = [content.decode(errors="replace").splitlines() for content in (before, now)]
            lines += list(difflib.unified_diff(texts[0], texts[1], "recorded", "now", lineterm=""))[:40]
        lines.append(f"differs: {name}")
    return lines


def _contents(path: Path) -> bytes:
    return path.read_bytes() if path.exists() else b"(missing)"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.corpus")
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--record", type=Path, metavar="FOLDER")
    action.add_argument("--compare", type=Path, metavar="FOLDER")
    arguments = parser.parse_args()
    os.environ.pop("PNEUMA_RESULTS", None)
    if arguments.record:
        arguments.record.mkdir(parents=True)
        write_outputs(arguments.record.resolve())
        return 0
    with tempfile.TemporaryDirectory() as folder:
        write_outputs(Path(folder))
        lines = differences(Path(folder), arguments.compare)
    print("\n".join(lines) or "no output differs")
    return int(bool(lines))


if __name__ == "__main__":
    raise SystemExit(main())
