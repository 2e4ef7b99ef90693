"""Train the studies of one part of the thesis, each in all its worlds; or plan, publish or draw them.

    python studies/scripts/reproduce.py small-networks            # as `make reproduction`
    python studies/scripts/reproduce.py small-networks plan       # as `make reproduction DO=plan`
    python studies/scripts/reproduce.py small-networks run --studies clip-range --seeds 2 --steps 4096

Each step is `pneuma study COMMAND STUDY`, to which other options are passed on. A run that crashed stops no
other study.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence

from pneuma.analysis.claims.preset import fixed_amounts
from pneuma.study.spec import load_study

PARTS = {
    "small-networks": (
        "own-game", "activation", "optimizer", "actor-size", "early", "hyperparameters", "clip-range",
        "gradient-limits", "sigmoid", "magic", "classes",
    ),
    "other-networks": ("architecture",),
    "other-chapters": (
        "policy-gradient", "perception", "vision", "team", "algorithms", "generalisation",
        "simplifications", "published-logs",
    ),
    "causes": (
        "betas-by-clip", "betas-longer", "betas-learned", "xp-scope", "xp-scope-longer", "sizes",
        "collapse", "late-collapse", "robustness", "noise-scale", "betas-and-units", "three-updates",
        "greedy-gap",
    ),
    "winners": (
        "tuned", "ladder", "changes", "islands", "godot-needs", "godot-ladder", "godot-changes",
        "tuned-optimizers", "tuned-algorithms",
    ),
}  # fmt: skip
"""The most important first. Of networks, only worlds in which claims fix runs."""
WORLDS = ("arena", "text", "godot")
CURVES = {"collapse": "return,entropy,dead_units,actions", "robustness": "none"}
"""The curves that a published table keeps, where they are not the default ones."""


def commands(
    part: str,
    command: str = "run",
    studies: Sequence[str] = (),
    worlds: Sequence[str] = WORLDS,
    steps: int | None = None,
    options: Sequence[str] = (),
) -> Iterator[list[str]]:
    """Yield the command lines of a part, without the name of the program."""
    is_of_claims = part.endswith("-networks")
    for name in studies or PARTS[part]:
        study = load_study(name)
        for world in (world for world in worlds if world in study.worlds):
            if is_of_claims and not fixed_amounts(study.in_world(world)):
                continue  # no claim is about the study there
            words = ["study", command, name, "--world", world]
            words += ["--steps", str(steps)] if steps else []
            words += ["--curves", CURVES[name]] if command == "publish" and name in CURVES else []
            if command not in ("run", "plan"):
                yield [*words, *options]
                continue
            for preset in study.presets:
                if preset.startswith("paper"):
                    yield [*words, "--preset", preset, *options]


def main() -> None:
    """Run all commands of a part, one after the other; exit with 1 if some failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0], allow_abbrev=False)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("command", nargs="?", default="run", help="of `pneuma study` (default: run)")
    parser.add_argument("--studies", nargs="+", default=[], help="only these of the part")
    parser.add_argument("--world", choices=WORLDS, help="only this world")
    parser.add_argument("--steps", type=int, help="instead of the steps of claims and presets")
    arguments, options = parser.parse_known_args()
    unknown = set(arguments.studies) - set(PARTS[arguments.part])
    if unknown:
        parser.error(f"{', '.join(sorted(unknown))}: {arguments.part} has {', '.join(PARTS[arguments.part])}")
    part, command = arguments.part, arguments.command
    worlds = [arguments.world] if arguments.world else WORLDS
    tolerated_code = 1 if command in ("run", "plan") else 2  # after a crash, or where nothing is stored

    begun, failed, stopped = time.monotonic(), [], []
    signal.signal(signal.SIGINT, lambda *_: stopped.append(True))  # Ctrl-C ends the command, then this
    for words in commands(part, command, arguments.studies, worlds, arguments.steps, options):
        code = subprocess.run([sys.executable, "-P", "-m", "pneuma", *words]).returncode
        if stopped:
            sys.exit(130)
        if code == tolerated_code:
            failed.append(" ".join(words))
        elif code:
            sys.exit(code)
    minutes, seconds = divmod(round(time.monotonic() - begun), 60)
    print(f"{part}: {minutes // 60} h {minutes % 60} min {seconds} s.")
    if failed:
        sys.exit("\n".join(["Failed (see above):", *failed]))


if __name__ == "__main__":
    main()
