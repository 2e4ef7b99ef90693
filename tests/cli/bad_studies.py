"""A study with every key that there is, what no key may be, and a walk over the keys of a file.

What is allowed is written out here once more, apart from the code.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

MAXIMAL = '''\
title = "All there is"
section = "1"
about = """
Every key that a study may have:
gamma = is no key in here.
"""
figure = "all"
base = "table-6-1"
baseline = "adam"
keep_checkpoints = 3
gpu = ["adam", "slow"]
worlds = ["text", "godot"]

[run]   # what all conditions share
env = "pneuma/Pneuma-v0"
level = "thesis"
random_levels = 1
characters = "pygame"
players = 2
classes = ["base", "tank"]
weapons = ["own", "sword"]
magic = true
reward = ["thesis", "kills"]
observation = "pygame"
perceive = "nearest:4"
order = "fixed"
scale = "raw"
start = "first"
observe_facing = true
bodies = "pass"
coast = "deadly"
trees = "pass"
terrain_stops = "players"
bite_while_knocked = true
healing_cap = true
kill_credit = "near"
xp_scope = "forever"
ending_cost = 1.5
episode_steps = 500
time_limit = "terminate"
end_on_clear = true
engine = "sb3"
algorithm = "ppo"
slots = 2
learners = "shared"
actor = [8]
critic = [8, 4]
activation = "relu"
gamma = 0.9
gae_lambda = 0.9
learning_rate = 1e-4
clip_range = 0.3
horizon = 32
minibatch = 16
epochs = 2
value_coefficient = 0.7
entropy_coefficient = 0.02
gradient_limit = 0.4
clip = "separate"
weight_decay = 0.1
evaluation_episodes = 5

[conditions.adam]
optimizer = "adam"
betas = [0.8, 0.9]
epsilon = 1e-6

[conditions.sgd]
optimizer = "sgd"
momentum = 0.9
dampening = 0.9

[conditions]
rmsprop = { optimizer = "rmsprop" }

[conditions.slow]
optimizer = "rmsprop"
smoothing = 0.9

[conditions.useful]
optimizer = "upgd"
utility_decay = 0.9
noise = 0.1

[conditions.trpo]
algorithm = "trpo"
value_baseline = false
target_kl = 0.02
conjugate_steps = 5
line_search_steps = 5

[conditions.dqn]
algorithm = "dqn"
exploration = 0.1
exploration_fraction = 0.2
buffer_size = 500
learning_starts = 50
train_every = 8
gradient_steps = 2
target_every = 400

[conditions.table]
env = "pneuma/Mailman-v0"
engine = "tabular"
algorithm = "q-learning"
action_slip = 0.1
reward_noise = 0.2

[presets.quick]
seeds = 2
steps = 1_000

[presets.standard]
seeds = [3, 5]
steps = 2_000

[presets.paper]
seeds = 5
steps = 3_000
'''

# --- What is not allowed, and what the message must say of it --------------------------------------


def _number(low: str, high: str, *wrong: str, whole: bool = False) -> tuple[tuple[str, ...], ...]:
    kind = "a whole number" if whole else "a number"
    fractions = ("1.5",) if whole else ()
    generic = ('"many"', "true", "[1]", "nan", "inf", "2020-01-01", *fractions)
    return (generic + wrong, tuple(word for word in (kind, low, high) if word))


def _count(low: int, high: int) -> tuple[tuple[str, ...], ...]:
    return _number(f"at least {low}", f"at most {high}", str(low - 1), str(high + 1), "-5", whole=True)


def _one_of(*names: str, near: str = "", empty: bool = False) -> tuple[tuple[str, ...], ...]:
    misspelt = near or names[0][:-2] + names[0][-1]
    wrong = (f'"{misspelt}"', "3", "true", f'["{names[0]}"]')
    return (wrong if empty else (*wrong, '""'), names)


def _flag() -> tuple[tuple[str, ...], ...]:
    return (("1", '"true"', "[]"), ("true or false",))


FRACTION = _number("at least 0", "at most 1", "-0.1", "1.1")
BELOW_ONE = _number("at least 0", "below 1", "-0.1", "1")
SEVERAL = ("3", '"3"', "[]", "[0]", "[65537]", "[1.5]", '["8"]', "[1, 1, 1, 1, 1, 1, 1, 1, 1]")

WRONG: dict[str, tuple[tuple[str, ...], ...]] = {
    "title": (("3", "[]", '""'), ("text",)),
    "section": (("6.2", "[]"), ("text",)),
    "about": (("3", "[]"), ("text",)),
    "figure": (("3", '"a/b"', '".."', '"a b"'), ()),
    "base": (('"table-6-3"', "62", '""'), ("table-6-1", "table-6-2")),
    "baseline": (("3", '"admm"'), ("condition",)),
    "keep_checkpoints": _count(0, 1000),
    "gpu": (("1", '"true"', "[3]", '["admm"]'), ("condition",)),
    "worlds": (("3", '"godot"', "[]", '["godo"]', "[[3]]"), ("text", "godot")),
    "env": _one_of("pneuma/Pneuma-v0", "pneuma/PneumaGodot-v0", "pneuma/PneumaArena-v0"),
    "level": (('"thesi"', '"/nowhere/level"', '"random:train:x"', '""', "3", "[]"), ("level",)),
    "random_levels": _count(1, 10_000),
    "characters": (('"pigame"', '"/nowhere/characters.toml"', "3", "[]"), ("characters",)),
    "players": _count(1, 8),
    "classes": (
        ('["base", "tnak"]', '"a b"', "[]", "3", '["base", 3]', '["base", "base", "base"]'),
        ("class",),
    ),
    "weapons": (
        ('["own", "swrod"]', '"a b"', "[]", "3", '["own", 3]', '["own", "own", "own"]'),
        ("weapon",),
    ),
    "magic": _flag(),
    "reward": (
        ('"thesi"', '"nowhere:reward"', '"json:nothing"', "[]", "3", '["kills", "kils"]'),
        ("reward",),
    ),
    "observation": _one_of("thesis", "pygame", "godot"),
    "perceive": (('"nearest:0"', '"nearest"', '"kind:"', '"kind:raccon"', "3", "[]"), ("perceive",)),
    "order": _one_of("nearest", "fixed", empty=True),
    "scale": _one_of("unit", "map", "raw", near="uint", empty=True),
    "start": _one_of("random", "first"),
    "observe_facing": _flag(),
    "bodies": _one_of("block", "pass"),
    "coast": _one_of("wall", "deadly", near="wal"),
    "trees": _one_of("wall", "pass", near="wal"),
    "terrain_stops": _one_of("all", "players"),
    "bite_while_knocked": _flag(),
    "healing_cap": _flag(),
    "kill_credit": _one_of("striker", "near"),
    "xp_scope": _one_of("episode", "forever"),
    "ending_cost": _number("at least 0", "at most 1000", "-0.1", "1000.1"),
    "episode_steps": _count(1, 1_000_000),
    "time_limit": _one_of("truncate", "terminate"),
    "end_on_clear": _flag(),
    "engine": _one_of("sb3", near="sb4"),
    "algorithm": _one_of("ppo", near="pppo"),
    "slots": _count(1, 1024),
    "actor": (SEVERAL, ("a list", "at least 1", "at most 65536")),
    "critic": (SEVERAL, ("a list", "at least 1", "at most 65536")),
    "activation": _one_of("tanh", "relu", "leaky-relu", near="tahn"),
    "gamma": FRACTION,
    "gae_lambda": FRACTION,
    "learning_rate": _number("above 0", "at most 100", "0", "-1", "101"),
    "clip_range": _number("above 0", "at most 100", "0", "-1", "101"),
    "horizon": _count(2, 1_000_000),
    "minibatch": _count(2, 1_000_000),
    "epochs": _count(1, 1000),
    "value_coefficient": _number("at least 0", "at most 1e+06", "-1", "1000001"),
    "entropy_coefficient": _number("at least 0", "at most 1e+06", "-1", "1000001"),
    "gradient_limit": _number("above 0", '"none"', "0", "-1", "1e10"),
    "clip": _one_of("joint", "separate"),
    "learners": _one_of("shared", "independent"),
    "optimizer": _one_of("adam", "sgd", "rmsprop", "upgd", near="adma"),
    "betas": (
        ("0.9", "[0.9]", "[0.9, 1]", "[0.9, -0.1]", "[0.9, 0.9, 0.9]", '["a", "b"]'),
        ("2 of", "below 1"),
    ),
    "epsilon": _number("above 0", "at most 1", "0", "-1", "1.1"),
    "momentum": BELOW_ONE,
    "dampening": FRACTION,
    "smoothing": BELOW_ONE,
    "utility_decay": BELOW_ONE,
    "noise": _number("at least 0", "at most 1000", "-1", "1001"),
    "weight_decay": FRACTION,
    "value_baseline": _flag(),
    "target_kl": _number("above 0", "at most 100", "0", "-1", "101"),
    "conjugate_steps": _count(1, 1000),
    "line_search_steps": _count(1, 1000),
    "exploration": FRACTION,
    "exploration_fraction": FRACTION,
    "buffer_size": _count(1, 10**8),
    "learning_starts": _count(0, 10**9),
    "train_every": _count(1, 10**6),
    "gradient_steps": _count(1, 10_000),
    "target_every": _count(1, 10**12),
    "action_slip": FRACTION,
    "reward_noise": _number("at least 0", "at most 1e+06", "-1", "1000001"),
    "evaluation_episodes": _count(1, 10_000),
    "seeds": (
        ("0", "-1", "10_001", "1.5", '"3"', "true", "[]", "[1, 1]", "[-1]", "[4294967296]", "[1.5]", '["3"]'),
        ("count", "10000", "4294967295"),
    ),
    "steps": _count(1, 10**12),
    "run": (("3", "[]"), ("table",)),
    "factors": (("3", "[]"), ("table",)),
    "conditions": (("3", "[]"), ("table",)),
    "presets": (("3", "[]"), ("table",)),
}
"""By key: values that are not allowed, and words that the message must have of what is."""


OWN_NAME = "rmsprop"
"""A condition of the maximal study that is set on one line: its name is the writer's to choose."""


# --- Walking over a file ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Place:
    """A key in a file: its line from 1, the lines that its value takes up, and where the key stands."""

    key: str
    line: int
    lines: int
    start: int

    def replaced(self, text: str, key: str | None = None, value: str | None = None) -> str:
        """Return the file with another key, or another value, here."""
        lines = text.splitlines()
        row = lines[self.line - 1]
        after = row[self.start + len(self.key) :]
        if value is None:
            lines[self.line - 1] = f"{row[: self.start]}{key}{after}"
        else:
            lines[self.line - 1 : self.line - 1 + self.lines] = [f"{row[: self.start]}{self.key} = {value}"]
        return "\n".join(lines) + "\n"


def places(text: str) -> Iterator[Place]:
    """Yield the keys with values that stand at the beginning of a line, but not those of [factors]."""
    lines = text.splitlines()
    number, header = 0, ""
    while number < len(lines):
        header = lines[number] if lines[number].startswith("[") else header
        found = re.match(r"([\w-]+)\s*=\s*(\"\"\")?", lines[number])
        length = 1
        if found and found[2]:
            length = next(i for i, line in enumerate(lines[number + 1 :], 2) if line.endswith('"""'))
        if found and found[1] != OWN_NAME and header.strip() != "[factors]":
            yield Place(found[1], number + 1, length, 0)
        number += length


def header_places(text: str) -> Iterator[Place]:
    """Yield the words of table headers that are not for their writer to choose."""
    for number, line in enumerate(text.splitlines(), 1):
        if found := re.match(r"\[(\w+)(?:\.([\w-]+))?\]", line):
            yield Place(found[1], number, 1, 1)
            if found[1] == "presets":
                yield Place(found[2], number, 1, found.start(2))


def misspellings(key: str) -> list[str]:
    """Return the key with a letter left out, replaced, doubled, and exchanged with its neighbour."""
    middle = len(key) // 2
    left_out = key[:middle] + key[middle + 1 :]
    doubled = key[:middle] + key[middle] + key[middle:]
    exchanged = key[: middle - 1] + key[middle] + key[middle - 1] + key[middle + 1 :]
    replaced = key[:middle] + "z" + key[middle + 1 :]
    return [word for word in (left_out, replaced, doubled, exchanged) if word != key]
