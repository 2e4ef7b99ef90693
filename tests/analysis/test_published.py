"""A study's published table: the same bytes, whole or refused, and the same figure without the runs."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from pneuma.analysis import WINDOWS
from pneuma.analysis.bands import BANDS
from pneuma.analysis.outcomes import OUTCOMES, outcome
from pneuma.analysis.packed import pack_signs, rounded, unpack_signs
from pneuma.analysis.published import published_path, published_studies, read_published
from pneuma.analysis.publishing import encode_study, runs_leaving, runs_staying
from pneuma.analysis.sources import open_study
from pneuma.errors import UserError
from pneuma.figures.curves import draw_study
from pneuma.study.store import Status, Store

from .published_runs import CELLS, RECORD, SETTINGS, longer_record, record_of, save_run

TIMES = ("wall-seconds", "steps-per-second")


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    for (_, seed), run_id in CELLS.items():
        save_run(store, run_id, seed)
    return store


def _publish(store: Store, record: dict[str, Any] = RECORD, to: Store | None = None) -> Path:
    path = published_path(to or store, "mine")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(encode_study(open_study(store, record)))
    return path


# --- Bytes ----------------------------------------------------------------------------------------


def test_the_same_runs_give_the_same_bytes_whenever_they_were_trained(store: Store, tmp_path: Path) -> None:
    again = Store(tmp_path / "again")
    for (_, seed), run_id in CELLS.items():
        killed = [{"step": 17 * seed, "at": "2021-12-31", "differences": []}]
        save_run(again, run_id, seed, started="2021-12-31 and it took longer", resumes=killed)
    assert _publish(store).read_bytes() == _publish(again).read_bytes()


def test_no_clock_is_in_it_and_what_produced_a_run_is(store: Store) -> None:
    table = pq.read_table(_publish(store))
    about = json.loads(table["provenance"][0].as_py())
    assert about == {"python": "3.11.7", "commit": "abc"}
    assert json.loads(table["settings"][0].as_py()) == SETTINGS


def test_a_resume_elsewhere_is_still_told(store: Store) -> None:
    """It could have given other bits."""
    differences = ["cpu (old, now new)", "torch (1, now 2)"]
    resumes = [{"step": 17, "at": "2021-12-31", "differences": differences[::-1]}] * 2
    save_run(store, "a0" * 8, 0, resumes=resumes)
    about = json.loads(pq.read_table(_publish(store))["provenance"][0].as_py())
    assert about["resumed_elsewhere"] == differences


def test_other_programs_can_read_it(store: Store) -> None:
    """A curve is a list of 200 numbers: at step 50, point 10, a mean of the one episode that ended."""
    frame = pq.read_table(_publish(store)).to_pandas()
    assert frame["condition"].tolist() == ["a", "b", "a", "b"]
    assert frame["return budget-5%"][2][9] == 2 / 3
    assert len(frame["entropy"][0]) == 200
    assert frame["evaluations"][0][3]["share_killed"] == 4 / 11


def test_a_run_takes_a_few_kilobytes(store: Store) -> None:
    """Design section 4: 20 MB over all studies."""
    many = {("a", seed): f"{seed:016x}" for seed in range(20)}
    for seed, run_id in enumerate(many.values()):
        save_run(store, run_id, seed)
    assert len(_publish(store, record_of(many)).read_bytes()) < 20 * 12_000 + 30_000


def test_rounded_it_takes_less_and_says_the_same(store: Store, tmp_path: Path) -> None:
    """Curves to a thousandth of their range; outcomes, signs and evaluations as they are."""
    many = CELLS
    data = open_study(store, RECORD)
    clone = Store(tmp_path / "clone")
    published_path(clone, "mine").parent.mkdir(parents=True)
    small = encode_study(data, ("return", "entropy"), rounding=True)
    published_path(clone, "mine").write_bytes(small)
    assert len(small) < 0.9 * len(encode_study(data))
    again = open_study(clone, record_of(many))
    assert again.quantities == ["return", "entropy"]
    for ours, theirs in zip(data.runs, again.runs, strict=True):
        assert {name: outcome(data, ours, name) for name in OUTCOMES if name not in TIMES} == pytest.approx(
            {name: outcome(again, theirs, name) for name in OUTCOMES if name not in TIMES},
            rel=0, abs=0, nan_ok=True,
        )  # fmt: skip
        assert data.source.signs(ours) == again.source.signs(theirs)
        for window in WINDOWS:
            exact, kept = (own.curve(ours, "return", window) for own in (data, again))
            span = np.nanmax(exact) - np.nanmin(exact)
            assert np.nanmax(abs(exact - kept)) <= span / 512
    with pytest.raises(UserError, match="holds no kills"):
        again.curve(again.runs[0], "kills")


def test_a_curve_over_orders_of_size_is_rounded_in_proportion() -> None:
    values = np.array([np.nan, 0.0, 1e-3, 1.0, 1e6, 3e6])
    kept = rounded(values)
    assert np.isnan(kept[0]) and kept[1:] == pytest.approx(values[1:], rel=1 / 1024, abs=0)
    assert rounded(kept).tolist()[1:] == kept.tolist()[1:]
    assert rounded(np.array([0.0, 0.25, 1.0])).tolist() == [0.0, 0.25, 1.0]
    for odd in ([-5e-324, 5e-324], [-1e308, 1e308], [-3.0, -3.0], [np.nan, np.inf]):
        assert np.array_equal(rounded(np.array(odd)), odd, equal_nan=True)


def test_signs_come_back_as_they_were() -> None:
    signs = {
        "one action": [(512.0, 512.0), (1024.0, 2048.0)],
        "dead units": [],
        "no entropy": [(256.0, 768.0)],
    }
    assert unpack_signs(pack_signs(signs)) == signs
    assert unpack_signs(pack_signs({})) == {}
    assert len(pack_signs(signs)) < len(json.dumps(signs))
    with pytest.raises(ValueError, match="no whole numbers"):
        pack_signs({"one action": [(0.5, 1.5)]})


# --- Damage ---------------------------------------------------------------------------------------


def test_one_flipped_bit_anywhere_is_noticed(store: Store) -> None:
    path = _publish(store)
    data = path.read_bytes()
    for place in range(0, len(data), 37):
        path.write_bytes(data[:place] + bytes([data[place] ^ (1 << place % 8)]) + data[place + 1 :])
        with pytest.raises(UserError, match="mine.parquet: damaged; take it from version control again"):
            read_published(store, "mine")
    path.write_bytes(data)
    read_published(store, "mine")


@pytest.mark.parametrize("size", [0, 1, 100, -1])
def test_a_table_cut_short_is_noticed(store: Store, size: int) -> None:
    path = _publish(store)
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(UserError, match="damaged"):
        read_published(store, "mine")


def test_damage_is_no_matter_while_the_runs_are_there(store: Store) -> None:
    _publish(store).write_bytes(b"damaged")
    assert len(open_study(store, RECORD).runs) == 4


def test_a_missing_table_is_told(store: Store) -> None:
    with pytest.raises(UserError, match="mine.parquet: cannot be read"):
        read_published(store, "mine")
    assert published_studies(store) == []


# --- In place of the runs -------------------------------------------------------------------------


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("band", BANDS)
def test_the_figure_is_the_same_byte_for_byte(store: Store, tmp_path: Path, band: str, window: str) -> None:
    clone = Store(tmp_path / "clone")
    _publish(store, to=clone)
    record = read_published(clone, "mine").record
    options: Any = {"band": band, "window": window, "formats": ("svg", "png")}
    ours = draw_study(open_study(store, RECORD), tmp_path / "ours", **options)
    theirs = draw_study(open_study(clone, record), tmp_path / "theirs", **options)
    assert [path.read_bytes() for path in ours] == [path.read_bytes() for path in theirs]


def test_a_selection_finds_its_runs_in_the_table_by_their_ids(store: Store, tmp_path: Path) -> None:
    clone = Store(tmp_path / "clone")
    _publish(store, to=clone)
    wanted = record_of({("b", 1): "b1" * 8, ("c", 0): "c0" * 8})
    data = open_study(clone, wanted)
    assert [(run.condition, run.seed) for run in data.runs] == [("b", 1)]
    assert data.left_out == 1
    with pytest.raises(UserError, match="no run of this selection"):
        open_study(clone, record_of({("c", 0): "c0" * 8}))


def test_runs_that_never_finished_keep_their_place(store: Store, tmp_path: Path) -> None:
    """The colours of a figure are given out by place."""
    record = record_of({("never", 0): "ff" * 8, **CELLS})
    store.save_run("ff" * 8, Status("crashed", 100), {})
    clone = Store(tmp_path / "clone")
    _publish(store, record, to=clone)
    published = read_published(clone, "mine")
    data = open_study(clone, published.record)
    assert data.conditions == ["never", "a", "b"]
    assert (data.left_out, len(data.runs)) == (1, 4)
    assert published.status("ff" * 8).name == "crashed"


def test_one_run_under_two_names_is_published_under_both(store: Store, tmp_path: Path) -> None:
    record = {**record_of({("a", 0): "a0" * 8, ("twin", 0): "a0" * 8}), "same": [["a", "twin"]]}
    clone = Store(tmp_path / "clone")
    _publish(store, record, to=clone)
    data = open_study(clone, read_published(clone, "mine").record)
    assert [run.condition for run in data.runs] == ["a", "twin"]
    assert data.same == [["a", "twin"]]


# --- Part by part -----------------------------------------------------------------------------------


def _publish_beside(store: Store, before: Store, **options: Any) -> bytes:
    return encode_study(open_study(store, RECORD), **options, published=read_published(before, "mine"))


def _part(tmp_path: Path, seed: int) -> Store:
    """A results folder with the runs of one seed, and the others' names."""
    store = Store(tmp_path / f"seed {seed}")
    for (_, own), run_id in CELLS.items():
        if own == seed:
            save_run(store, run_id, own)
    return store


@pytest.mark.parametrize("options", [{}, {"rounding": True}, {"curves": ("return",), "rounding": True}])
def test_published_part_by_part_it_is_the_same_to_the_byte(
    store: Store, tmp_path: Path, options: dict[str, Any]
) -> None:
    """Machines that share nothing but the table make the table that one machine makes."""
    first, second = _part(tmp_path, 0), _part(tmp_path, 1)
    path = _publish(first)
    path.write_bytes(encode_study(open_study(first, RECORD), **options))
    whole = encode_study(open_study(store, RECORD), **options)
    assert path.read_bytes() != whole
    assert _publish_beside(second, first, **options) == whole


def test_only_the_selections_runs_stay_and_those_that_are_here_are_taken_anew(
    store: Store, tmp_path: Path
) -> None:
    _publish(store)
    second = _part(tmp_path, 1)
    save_run(second, "b1" * 8, 1, python="3.12.0")
    fewer = record_of({cell: run_id for cell, run_id in CELLS.items() if cell != ("b", 0)})
    data, before = open_study(second, fewer), read_published(store, "mine")
    assert runs_staying(data, before) == ["a0" * 8]
    table = pq.read_table(io.BytesIO(encode_study(data, published=before)))
    assert table["run_id"].to_pylist() == ["a0" * 8, "a1" * 8, "b1" * 8]
    versions = [json.loads(text)["python"] for text in table["provenance"].to_pylist()]
    assert versions == ["3.11.7", "3.11.7", "3.12.0"]


def test_a_run_that_crashed_here_stays_as_it_was_published(store: Store, tmp_path: Path) -> None:
    second = _part(tmp_path, 1)
    second.save_run("a0" * 8, Status("crashed", 100), {})
    _publish(store)
    assert _publish_beside(second, store) == published_path(store, "mine").read_bytes()


@pytest.mark.parametrize("options", [{"rounding": True}, {"curves": ("return",)}])
def test_runs_whose_other_curves_were_kept_are_not_mixed_with_new_ones(
    store: Store, tmp_path: Path, options: dict[str, Any]
) -> None:
    _publish(store)
    wanted = "differ in .* publish with the same --curves and --round as before"
    with pytest.raises(UserError, match=wanted):
        _publish_beside(_part(tmp_path, 1), store, **options)
    _publish_beside(store, store, **options)  # all are here: nothing is mixed


def test_rounded_curves_are_not_mixed_with_exact_ones_of_the_same_columns(
    store: Store, tmp_path: Path
) -> None:
    path = _publish(store)
    path.write_bytes(encode_study(open_study(store, RECORD), ("entropy",)))
    with pytest.raises(UserError, match="differ in rounding, and"):
        _publish_beside(_part(tmp_path, 1), store, curves=("entropy",), rounding=True)


def _in_parts(tmp_path: Path, record: dict[str, Any]) -> bytes:
    first, second = _part(tmp_path, 0), _part(tmp_path, 1)
    _publish(first, record)
    return encode_study(open_study(second, record), published=read_published(first, "mine"))


def test_short_runs_join_the_grid_of_longer_ones(store: Store, tmp_path: Path) -> None:
    assert _in_parts(tmp_path, longer_record(0)) == encode_study(open_study(store, longer_record(0)))


def test_short_runs_whose_curves_end_too_early_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="up to step 1,000, these need 2,000.* those of most steps first"):
        _in_parts(tmp_path, longer_record(1))


@pytest.mark.parametrize("seed", [0, 1])
def test_evaluations_of_action_values_join_those_without(store: Store, tmp_path: Path, seed: int) -> None:
    """Runs of DQN have two columns more, PPO's in the same table none of them."""
    first, second = _part(tmp_path, 0), _part(tmp_path, 1)
    for to in (first if seed == 0 else second, store):
        for name in "ab":
            save_run(to, f"{name}{seed}" * 8, seed, valued=True)
    _publish(first)
    assert _publish_beside(second, first) == encode_study(open_study(store, RECORD))


def test_counts_that_are_whole_in_one_part_alone_are_fractions_in_both(store: Store, tmp_path: Path) -> None:
    first, second = _part(tmp_path, 0), _part(tmp_path, 1)
    for to in (first, store):
        save_run(to, "b0" * 8, 0, played=50.5)
    _publish(second)
    assert _publish_beside(first, second) == encode_study(open_study(store, RECORD))


def test_runs_that_failed_elsewhere_are_still_told(store: Store, tmp_path: Path) -> None:
    store.save_run("ff" * 8, Status("crashed", 100), {})
    record = record_of({**CELLS, ("a", 2): "ff" * 8})
    _publish(store, record)
    data = open_study(_part(tmp_path, 1), record)
    encoded = encode_study(data, published=read_published(store, "mine"))
    assert encoded == published_path(store, "mine").read_bytes()


def test_a_run_that_finishes_meanwhile_has_no_numbers_yet(store: Store, tmp_path: Path) -> None:
    part = _part(tmp_path, 1)
    data = open_study(part, RECORD)
    save_run(part, "a0" * 8, 0)
    published_path(part, "mine").parent.mkdir(parents=True)
    published_path(part, "mine").write_bytes(encode_study(data))
    told = read_published(part, "mine")
    assert told.status("a0" * 8).name == "running"
    assert len(open_study(part, {**told.record, "source": "runs"}).runs) == 3


def test_published_runs_that_a_selection_leaves_out_are_known(store: Store) -> None:
    _publish(store)
    fewer = record_of({cell: run_id for cell, run_id in CELLS.items() if cell[0] == "a"})
    assert runs_leaving(open_study(store, fewer), read_published(store, "mine")) == ["b0" * 8, "b1" * 8]
