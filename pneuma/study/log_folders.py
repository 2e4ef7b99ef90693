"""Folders of TensorBoard logs: which runs lie below a folder, and what they are called.

Stable-Baselines3 writes the first run that is called NAME to NAME_1/, the next to NAME_2/: NAME is
taken for the condition and the number for the seed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from pneuma.errors import UserError

EVENT_FILE = "tfevents"
"""A part of every event file's name."""


@dataclass(frozen=True)
class LogFolder:
    """One run's folder.

    Attributes:
        shown: its path below the folder that was asked for, for people.
        condition, seed: as its name says.
        files: its event files, oldest first.
    """

    shown: str
    condition: str
    seed: int
    files: tuple[Path, ...]


def find_logs(root: Path) -> tuple[list[LogFolder], list[str]]:
    """Find every folder below `root`, itself included, that holds event files.

    The condition is the folder's path without the number behind its last underscore and without the
    folders that all runs share. A folder without a number is seed 0. Where two would be the same
    seed of a condition, one takes the next free number.

    Returns:
        The folders, by condition and seed, and notes on seeds that were not as the name says.

    Raises:
        UserError: where there are none, or `root` is no folder that can be read.
    """
    if not root.is_dir():
        raise UserError(f"{root}: is no folder; name the folder that holds NAME_1/, NAME_2/, …")
    try:
        paths = [path for path in root.rglob(f"*{EVENT_FILE}*") if path.is_file()]
    except OSError as error:
        raise UserError(f"{root}: cannot be read ({error.strerror})") from None
    if not paths:
        raise UserError(f"{root}: no TensorBoard event files (events.out.tfevents…) in it or below")
    by_folder: dict[Path, list[Path]] = {}
    for path in sorted(paths, key=lambda path: _in_numbers(path.name)):
        by_folder.setdefault(path.parent, []).append(path)
    parts = {folder: _parts(folder, root) for folder in by_folder}
    shared = _shared_length(list(parts.values()))
    named = {folder: _condition_and_number(own[shared:]) for folder, own in parts.items()}
    seeds, notes = _seeds({"/".join(parts[folder]): name for folder, name in named.items()})
    folders = [
        LogFolder("/".join(own), named[folder][0], seeds["/".join(own)], tuple(by_folder[folder]))
        for folder, own in parts.items()
    ]
    return sorted(folders, key=lambda log: (_in_numbers(log.condition), log.seed)), notes


def _seeds(named: Mapping[str, tuple[str, int | None]]) -> tuple[dict[str, int], list[str]]:
    """Return each folder's seed, and notes; `named` holds condition and number by what is shown."""
    seeds: dict[str, int] = {}
    notes = []
    asked = {(condition, number or 0) for condition, number in named.values()}
    taken: set[tuple[str, int]] = set()
    for shown in sorted(named, key=lambda shown: (named[shown][1] is None, _in_numbers(shown))):
        condition, seed = named[shown][0], named[shown][1] or 0
        if (condition, seed) in taken:
            free = next(n for n in count() if (condition, n) not in asked | taken)
            notes.append(f"{shown}: seed {seed} of {condition} is taken, so it is seed {free}")
            seed = free
        taken.add((condition, seed))
        seeds[shown] = seed
    return seeds, notes


def _parts(folder: Path, root: Path) -> tuple[str, ...]:
    return folder.relative_to(root).parts or (root.resolve().name,)


def _shared_length(paths: list[tuple[str, ...]]) -> int:
    """Return how many leading folders all have in common, the last of each left out."""
    least = min(len(parts) for parts in paths) - 1
    return next((k for k in range(least) if len({parts[k] for parts in paths}) > 1), least)


def _condition_and_number(parts: tuple[str, ...]) -> tuple[str, int | None]:
    """Return a condition's name and a number, if there is one.

    Legends leave out what begins with _, so that `_PPO` becomes `PPO_`.
    """
    name, number = _name_and_number(parts)
    bare = name.lstrip("_")
    return (bare.lstrip("/ ") or "run") + "_" * (len(name) - len(bare)), number


def _name_and_number(parts: tuple[str, ...]) -> tuple[str, int | None]:
    for place in reversed(range(len(parts))):
        match = re.fullmatch(r"(.+)_([0-9]{1,18})", parts[place])
        if match:
            return "/".join((*parts[:place], match[1], *parts[place + 1 :])), int(match[2])
    return "/".join(parts), None


def _in_numbers(name: str) -> list[tuple[int, int, str]]:
    """Return a key that puts run_2 before run_10."""
    pieces = re.split(r"([0-9]+)", name)
    return [(1, int(piece), "") if piece.isdecimal() else (0, 0, piece) for piece in pieces if piece]
