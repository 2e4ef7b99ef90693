"""Whatever a file holds, its reader gives a value or one error of its own."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pneuma.analysis.claims.claim_list import load_claims
from pneuma.engines.policy import read_sound_policy
from pneuma.engines.records import EPISODE_COLUMNS, Checkpoint, Records
from pneuma.env.characters import load_characters
from pneuma.env.load_level import load_level
from pneuma.errors import UserError
from pneuma.files import checksum, dump_checksummed, to_json
from pneuma.imports.tensorboard import read_event_file
from pneuma.search.spec import load_search
from pneuma.store.checkpoints import encode, read_checkpoint, table_files
from pneuma.store.index import RunIndex
from pneuma.store.row_builder import row_cells, stored_row
from pneuma.store.rows import encode_row
from pneuma.store.series import Recorded
from pneuma.store.store import CheckpointFile, Status, Store
from pneuma.store.tables import to_parquet
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study
from pneuma.training.execute import check_environments

from .cli.calls import policy_of
from .hand_made import encode_events

READERS: dict[str, Callable[[str], Any]] = {
    "study": load_study,
    "search": load_search,
    "claims": load_claims,
    "characters": load_characters,
    "level": lambda path: load_level(str(Path(path).parent), {}),
}


@pytest.mark.parametrize("text", ["a." * 5000 + "a = 1", f"[{'a.' * 900}a]", f"a = {'[' * 5000}"])
@pytest.mark.parametrize("reader", [reader for reader in READERS if reader != "level"])
def test_fuzz_endless_nesting_is_refused(tmp_path: Path, reader: str, text: str) -> None:
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(UserError, match="mine.toml"):
        READERS[reader](str(tmp_path / "mine.toml"))


STUDY = 'title = "Mine"\n[run]\n{}\n{}[conditions.one]\n[presets.quick]\nseeds = 1\nsteps = 256\n'
CARTPOLE = 'env = "CartPole-v1"\n'
SEARCH = (
    'title = "Mine"\n[objectives.killed]\noutcome = "final-return"\n[space.learning_rate]\nlow = 1e-4\n'
    "high = 1e-2\n{}\n[presets.quick]\ntrials = 2\nseeds = 1\nsteps = 256\n"
)
CLAIMS = (
    '[claims.one]\nstudy = "activation"\na = "tanh"\noutcome = "final-return"\ndirection = "greater"\n'
    "steps = 1000\nseeds = 5\n{}\n"
)
LONG = "y" * 3000


def _plan(path: str) -> None:
    """As `study plan` does."""
    plan = make_plan(load_study(path), Query(path))
    check_environments([cell.run for cell in plan.cells])


@pytest.mark.parametrize(
    ("read", "text"),
    [
        *((_plan, STUDY.format(setting, "")) for setting in (
            f'level = "{LONG}"', f'characters = "{LONG}"', 'characters = "\\u0000"',
            CARTPOLE + "wrappers = [nan]", 'policy_kwargs = "a.b"',
            CARTPOLE + "algorithm_kwargs = { policy_kwargs = 1 }",
            "\n".join(f"k{number} = 1" for number in range(20_000)), f'level = "{LONG * 400}"',
        )),
        (_plan, STUDY.format("", "".join(f"[conditions.c{number}]\n" for number in range(5000)))),
        (_plan, STUDY.format("", f"[factors]\ngamma = {[0.5 + number / 1e6 for number in range(20_000)]}\n")),
        (_plan, STUDY.replace("1\n", "10_000\n").format("", "[factors]\nepochs = [1, 2, 3, 4, 5, 6]\n")),
        (_plan, STUDY.format("", "").replace("seeds = 1", f'seeds = "{"0..9999," * 50_000}"')),
        (load_search, SEARCH.format("step = 1e-320")),
        (load_claims, CLAIMS.format('preset = "quick"\nb = { a = 1 }')),
        (load_claims, CLAIMS.format('value = "none"')),
    ],
)  # fmt: skip
def test_fuzz_invalid_and_huge_values_are_refused(
    tmp_path: Path, read: Callable[[str], Any], text: str
) -> None:
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(UserError) as refused:
        read(str(tmp_path / "mine.toml"))
    assert "\n" not in str(refused.value)


# --- Damaged and made-up files ---------------------------------------------------------------------

ROOT = Path(__file__).parent.parent
TABLE = "published/author-logs.parquet"
ODD = [b"", b"\x00", b"\xff", b"-1", b"1e999", b"nan", b"9" * 5000, b"[" * 3000, b'"', b"\n", b"\x1b]0;a\x07"]


def _checkpoint(path: Path) -> None:
    """Read a checkpoint whose checksum is right, whatever it contains."""
    read_checkpoint(CheckpointFile(256, checksum(path.read_bytes())[:16], path))


def _published(path: Path) -> None:
    """Read a table whose checksum is right, whatever it contains."""
    blank = b"sha256:" + b"0" * 64
    data = re.sub(rb"sha256:[0-9a-f]{64}", blank, path.read_bytes())
    path.write_bytes(data.replace(blank, b"sha256:" + checksum(data).encode()))
    index = RunIndex(Store(path.parent.parent), shipped=False)
    if "author-logs" in index.tables:
        assert [*filter(None, map(index.row, index.frame.index))] or index.problems


def _run_file(path: Path) -> None:
    """Read the row of a run with a file whose checksum is right, whatever it contains."""
    documents = {"run.json": to_json({"run": {"steps": 1000}}), "provenance.json": to_json({})}
    tables = {f"{name}.parquet": data for name, data in table_files(Records()).items()}
    store = Store(path.parent / "results")
    store.save_run(RUN, Status("done", 1000), {**documents, **tables, path.name: path.read_bytes()})
    stored_row(store, RUN)


def _level(path: Path) -> None:
    (path.parent / "objects.csv").write_text("code,x,y\n400,-96,-64\n390,96,64\n")
    load_level(str(path.parent), {390: "bamboo"})


RUN = "a0" * 8
CELLS = row_cells(RUN, Status("done", 1000), {"steps": 1000}, Recorded({}, [{"step": 500}]), {})
ROWS = [{"step": 256, "policy_loss": 0.1, "entropy": 1.0}, {"step": 512, "policy_loss": 0.2, "entropy": 0.9}]
ROW = {**dict.fromkeys(EPISODE_COLUMNS, 1), "ending": "died"}
CHECKPOINT = Checkpoint(256, {"weights": np.arange(6.0).reshape(2, 3)}, {"seed": 3}, Records(episodes=[ROW]))
POINTS = [("rollout/ep_rew_mean", step, float(step)) for step in range(3)]
HISTORY: dict[str, Any] = {"attempts": []}
FILES: dict[str, tuple[str, Callable[[], bytes], Callable[[Path], object]]] = {
    "study": ("mine.toml", (ROOT / "studies/activation.toml").read_bytes, lambda path: load_study(str(path))),
    "search": ("s.toml", (ROOT / "studies/search/ppo.toml").read_bytes, lambda path: load_search(str(path))),
    "claims": ("mine.toml", (ROOT / "studies/claims.toml").read_bytes, load_claims),
    "level": ("island/obstacles.csv", lambda: b"-1,-1,-1,-1,-1,-1\n" * 6, _level),
    "checkpoint": ("256.safetensors", lambda: encode(CHECKPOINT, HISTORY, ""), _checkpoint),
    "policy": ("policy.safetensors", policy_of().to_bytes, lambda path: read_sound_policy(path.read_bytes())),
    "run table": ("metrics.parquet", lambda: to_parquet(ROWS, tuple(ROWS[0])), _run_file),
    "published": (TABLE, (ROOT / "results" / TABLE).read_bytes, _published),
    "listing": (
        "studies/mine.json", lambda: dump_checksummed({"study": "mine", "runs": []}),
        lambda path: Store(path.parent.parent).listing("mine"),
    ),
    "row": ("row.arrow", lambda: encode_row(CELLS), _run_file),
    "events": ("events.out.tfevents.1.host", lambda: encode_events(POINTS), read_event_file),
}  # fmt: skip
"""Of every file that is read: its name, one that is sound, and its reader."""

DAMAGE = st.tuples(st.floats(0, 1), st.floats(0, 1), st.one_of(st.sampled_from(ODD), st.binary(max_size=20)))


@pytest.mark.parametrize("kind", FILES)
def test_fuzz_a_damaged_file_gives_a_value_or_one_error(tmp_path: Path, kind: str) -> None:
    name, sound, read = FILES[kind]
    whole = sound()
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(whole)
    read(path)

    @settings(max_examples=25, derandomize=True, database=None, deadline=None)
    @given(st.lists(DAMAGE, min_size=1, max_size=3))
    @example([(0.0, 1.0, b"")])
    @example([(0.5, 1.0, b"")])
    def damaged(cuts: list[tuple[float, float, bytes]]) -> None:
        data = whole
        for first, last, put in cuts:
            start, end = sorted((int(first * len(data)), int(last * len(data))))
            data = data[:start] + put + data[end:]
        path.write_bytes(data)
        with contextlib.suppress(UserError):
            read(path)

    damaged()
