"""The bits of short runs, which are the same on every processor: one digest a kind, in `bits.json`.

    python -m tests.bits [KIND ...]   compare those of this processor, of all kinds or of those with a word
    python -m tests.bits --record     write them anew, after a change that trains otherwise

A digest is of a run's policy and its tables: episodes, metrics, evaluations. `test_bits.py` compares them
under other targets of numba and other features of NumPy and the C library, and `make aarch64` on an emulated
processor of another kind, so this needs neither torch nor pytest.
"""

from __future__ import annotations

import hashlib
import json
import platform
import sys
from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
from numba.core.registry import cpu_target

from pneuma.config import ACTIVATIONS, make_run
from pneuma.engines.batched.initial_weights import _draw_reflectors, _reflect, initial_networks
from pneuma.engines.loop import Result, train_run
from pneuma.engines.policy import Policy
from pneuma.engines.records import Row
from pneuma.env.fields import ENVIRONMENTS

RECORD = Path(__file__).with_suffix(".json")
UPDATES = 3
SHORT: dict[str, Any] = {
    "horizon": 64, "minibatch": 32, "epochs": 2, "episode_steps": 60, "evaluation_episodes": 2, "slots": 1,
}  # fmt: skip
OPTIMIZERS: dict[str, dict[str, Any]] = {
    "adam": {},
    "sgd": {"optimizer": "sgd", "learning_rate": 0.1},
    "momentum": {"optimizer": "sgd", "momentum": 0.9, "dampening": 0.9, "learning_rate": 0.1},
    "rmsprop": {"optimizer": "rmsprop", "momentum": 0.5, "weight_decay": 0.01},
    "upgd": {"optimizer": "upgd", "noise": 0.1, "weight_decay": 0.01},
}
DEPTHS: dict[str, dict[str, Any]] = {
    "one layer": {"actor": (8,), "critic": (12,)},
    "three layers": {"actor": (40, 17, 33), "critic": (20, 40, 18)},  # over one and over two panels
}
TEAM = {"players": 2, "slots": 2, "horizon": 32, "episode_steps": 20}
OTHERS: dict[str, dict[str, Any]] = {
    "a smaller last minibatch": {"minibatch": 24},
    "no limit": {"gradient_limit": "none"},
    "separate limits": {"clip": "separate", "gradient_limit": 0.1},
    "players with one policy": TEAM,
    "players with their own policies": {**TEAM, "learners": "independent", "optimizer": "upgd"},
    "islands of mages": {
        "level": "random:train:0", "random_levels": 3, "magic": True, "classes": "mage", "held_out_levels": 2,
    },
    "annealed": {"learning_rate_schedule": "linear", "clip_range_schedule": "linear"},
    "normalized cartpole": {
        "env": "CartPole-v1", "slots": 2, "horizon": 32, "normalize_observations": True,
        "normalize_rewards": True, "learning_rate_schedule": "linear",
    },
}  # fmt: skip
"""In the first world, or another environment, with Adam and one layer."""
WEIGHTS = "initial weights of sixty seeds"
SEEDS = 60


def kinds() -> dict[str, dict[str, Any]]:
    """Return the fields of a run of each kind, by name."""
    fields_by_kind: dict[str, dict[str, Any]] = {}
    for world in ENVIRONMENTS:
        for activation in ACTIVATIONS:
            for optimizer, optimizer_fields in OPTIMIZERS.items():
                for depth, depth_fields in DEPTHS.items():
                    kind = f"{world}, {activation}, {optimizer}, {depth}"
                    fields = {"env": world, "activation": activation, **optimizer_fields, **depth_fields}
                    fields_by_kind[kind] = fields
    for kind, fields in OTHERS.items():
        fields_by_kind[kind] = {**DEPTHS["one layer"], **fields}
    return fields_by_kind


def digests(words: Iterable[str] = ()) -> dict[str, str]:
    """Return the digest of every kind, or of those whose names contain one of some words."""
    measured = {}
    for kind, fields in kinds().items():
        if is_chosen(kind, words):
            measured[kind] = digest_of_run(fields)
    if is_chosen(WEIGHTS, words):
        measured[WEIGHTS] = digest_of_initial_weights()
    return measured


def is_chosen(kind: str, words: Iterable[str]) -> bool:
    return not words or any(word in kind for word in words)


def digest_of_run(fields: dict[str, Any]) -> str:
    run = make_run({**SHORT, **fields, "steps": 1})
    run = make_run({**SHORT, **fields, "steps": UPDATES * run.steps_per_update})
    result = train_run(run, lambda progress: True)
    assert result.status == "done" and result.records.evaluations
    return digest_of_result(result)


def digest_of_result(result: Result) -> str:
    assert isinstance(result.policy, Policy)
    digest = hashlib.sha256(result.policy.checksum.encode())
    for rows in (result.records.episodes, result.records.metrics, result.records.evaluations):
        for row in rows:
            digest.update(_text(row).encode())
    return digest.hexdigest()[:16]


def digest_of_initial_weights() -> str:
    """Digest networks with fewer outputs than inputs, and with more."""
    digest = hashlib.sha256()
    for seed in range(SEEDS):
        networks = initial_networks(make_run({"seed": seed, "actor": (128, 40), "critic": (200,)}), 60, 5)
        digest.update(Policy("tanh", networks["actor"], networks["critic"]).checksum.encode())
        digest.update(unrounded_weights(seed, inputs=60, outputs=128).tobytes())
    return digest.hexdigest()[:16]


def unrounded_weights(seed: int, inputs: int, outputs: int) -> np.ndarray:
    """Return orthogonal weights in double precision, for more outputs than inputs: (outputs, inputs).

    Their rounding to float32 hides most of what differs between processors, as that of a LAPACK's QR does.
    """
    reflectors, signs = np.zeros((inputs, outputs)), np.empty(inputs)
    _draw_reflectors(np.uint64(seed), np.uint64(0), reflectors, signs)
    columns = np.empty((outputs, inputs))
    _reflect(reflectors, signs, columns)
    return columns


def _text(row: Row) -> str:
    """Return a row's cells in the order of their names; a NaN has no sign, which differs by processor."""
    cells = []
    for column in sorted(row):
        cell = row[column]
        cells.append(f"{column}={cell if isinstance(cell, str) else float(cell).hex()}")
    return " ".join(cells) + "\n"


def differences(measured: dict[str, str], recorded: dict[str, str]) -> list[str]:
    """Return the kinds that differ, or that one of both lacks."""
    return [kind for kind in measured | recorded if measured.get(kind) != recorded.get(kind)]


def recorded(words: Iterable[str] = ()) -> dict[str, str]:
    """Return what `bits.json` has of the kinds whose names contain one of some words."""
    return {kind: bits for kind, bits in json.loads(RECORD.read_text()).items() if is_chosen(kind, words)}


def main(arguments: list[str]) -> int:
    """Record the digests, or compare them; return 1 where anything differs."""
    if find_spec("torch") is None:  # training seeds it, for environments that use it
        sys.modules["torch"] = MagicMock()
    if arguments == ["--record"]:
        RECORD.write_text(json.dumps(digests(), indent=1) + "\n")
        return 0
    different = differences(digests(arguments), recorded(arguments))
    for kind in different:
        print(f"other bits: {kind}")
    _, target, _ = cpu_target.target_context.codegen().magic_tuple()
    system = f"{platform.system()} {platform.machine()}"
    print(f"{len(recorded(arguments))} kinds, {len(different)} differ ({system}, {target})")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
