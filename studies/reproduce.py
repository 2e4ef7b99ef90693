"""Train the studies of one part of the thesis, each in all its worlds; or plan, publish or draw them alike.

    python studies/reproduce.py small-networks            # as `make reproduction`
    python studies/reproduce.py small-networks plan       # as `make reproduction DO=plan`
    python studies/reproduce.py small-networks run --studies clip-range --seeds 2 --steps 4096

Each step is `pneuma study COMMAND STUDY`, to which options other than --studies are passed on. A run that
crashed stops no other study.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence

from pneuma.study.claimed import fixed_amounts
from pneuma.study.spec import load_study

PARTS = {
    "small-networks": (
        "activation", "optimizer", "early", "gradient-limits", "hyperparameters", "clip-range", "actor-size",
    ),
    "other-networks": ("generalisation", "architecture"),
    "other-chapters": (
        "tabular", "policy-gradient", "sigmoid", "magic", "classes", "perception", "vision", "algorithms",
        "published-logs",
    ),
    "crossed": ("collapse", "robustness"),
}  # fmt: skip
"""Of the networks of chapter 6 the runs that claims fix; of the others the preset `paper`."""
CURVES = {"tabular": "return,length", "collapse": "entropy,dead_units,actions", "robustness": "none"}
"""The curves that a published table keeps, where they are not the usual ones."""
ORDER = ("arena", "text", "godot")
FAILED = {"publish": 2}
"""The exit code after which the other studies go on, where it is not 1 (a run crashed)."""


def commands(part: str, command: str, studies: Sequence[str], options: Sequence[str]) -> Iterator[list[str]]:
    """Yield the command lines of a part, without the name of the program."""
    preset = "claims" if part.endswith("-networks") else "paper"
    for name in studies or PARTS[part]:
        study = load_study(name)
        for world in (world for world in ORDER if world in study.worlds):
            budgets = [*fixed_amounts(study.in_world(world))] if preset == "claims" else [None]
            for place, steps in enumerate(budgets):
                words = ["study", command, name, "--world", world, *options]
                if command in ("run", "plan"):
                    words += ["--preset", preset]
                if len(budgets) > 1 and "--steps" not in options:
                    words += ["--steps", str(steps)]
                if command == "publish":
                    words += ["--curves", CURVES[name]] if name in CURVES else []
                    words += ["--as", f"{name}-{steps}"] if place else []  # one table has one budget
                yield words


def main() -> None:
    """Run all commands of a part, one after the other; exit with 1 if some failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0], allow_abbrev=False)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("command", nargs="?", default="run", help="of `pneuma study` (default: run)")
    parser.add_argument("--studies", nargs="+", default=[], help="only these")
    known, options = parser.parse_known_args()
    signal.signal(signal.SIGINT, lambda *_: None)  # Ctrl-C ends the command, whose code ends all
    begun, failed = time.monotonic(), []
    for words in commands(known.part, known.command, known.studies, options):
        code = subprocess.run([sys.executable, "-m", "pneuma", *words]).returncode
        if code == FAILED.get(known.command, 1):
            failed.append(" ".join(words))
        elif code:
            sys.exit(code)
    minutes, seconds = divmod(round(time.monotonic() - begun), 60)
    print(f"{known.part}: {minutes // 60} h {minutes % 60} min {seconds} s.")
    if failed:
        sys.exit("\n".join(["Failed, as said above:", *failed]))


if __name__ == "__main__":
    main()
