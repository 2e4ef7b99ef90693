"""`pneuma study delete` and `pneuma run delete`: what is removed, and what stays."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.store.last_queries import last_query
from pneuma.store.locks import run_lock
from pneuma.store.store import Store, run_identity
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study
from pneuma.training.executors import local

from .calls import TINY, call, described, finish_study, refused


def test_a_study_is_removed_but_for_runs_that_another_one_has_too(store: Store) -> None:
    """tanh in the study of activations is Table 6.2, as one of the clip ranges is."""
    activation = finish_study(store, seeds=(0, 1), steps=1024)  # tanh, ReLU, LeakyReLU, and again
    clip = finish_study(store, "clip-range", seeds=(0,), steps=1024, conditions=("0.1", "0.2"))
    assert activation[0] == clip[0]
    words = ("study", "delete", "activation", "--results", store.root)
    assert "--yes is required because this is not a terminal" in refused(*words)
    code, out, err = call(*words, "--yes")
    note = "Note: kept, as clip-range in the arena has them too: 1 run."
    assert (code, err, out.splitlines()[:2]) == (0, err, [note, f"Removed 5 runs from {store.root}."])
    assert {*store.runs()} == {*clip}


@pytest.mark.usefixtures("unshipped")
def test_two_studies_of_the_same_runs_are_removed_one_after_the_other(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While both were run here, the runs of either are the other's too."""
    monkeypatch.chdir(tmp_path)
    assert call("study", "new", "mine", "--from", "activation").code == 0
    for study in ("activation", "mine"):
        finish_study(store, study, seeds=(0,), steps=1024, conditions=("tanh",))
    words = ("study", "delete", "activation", "--yes", "--results", store.root)
    code, out, _ = call(*words)
    assert (code, out) == (0, "Note: kept, as mine in the arena has them too: 1 run.\nNothing was deleted.\n")
    removed = described("study", "delete", "mine", "--yes", "--json", "--results", store.root)["removed"]
    assert (len(removed), store.runs()) == (1, [])


@pytest.mark.usefixtures("unshipped")
def test_only_runs_of_the_cells_that_are_asked_for_are_removed(store: Store) -> None:
    short = finish_study(store, seeds=(0,), steps=1024, conditions=("tanh",))
    long = finish_study(store, seeds=(0,), steps=2048, conditions=("tanh",))
    words = ("study", "delete", "activation", "--yes", "--json", "--results", store.root)
    assert described(*words, "--steps", "1024")["removed"] == short
    assert store.runs() == long and last_query(store, "activation", "arena") is not None
    assert described(*words)["removed"] == long
    assert last_query(store, "activation", "arena") is None


def test_a_study_without_a_file_goes_with_the_last_of_its_runs(store: Store) -> None:
    ids = finish_study(store, noted=False, seeds=(0, 1), steps=1024, conditions=("tanh",))
    runs = [{"run_id": run_id, "condition": "tanh", "seed": seed} for seed, run_id in enumerate(ids)]
    store.save_listing("logs", {"title": "Logs", "baseline": "tanh", "runs": runs})
    words = ("study", "delete", "logs", "--yes", "--json", "--results", store.root)
    assert described(*words, "--seeds", "0,")["removed"] == ids[:1]
    assert store.listings() == ["logs"] and described(*words)["removed"] == ids[1:]
    assert store.listings() == []


def test_a_run_is_removed_by_its_id_unless_it_trains(store: Store) -> None:
    (cell,) = make_plan(
        load_study("activation"), Query(preset="quick", seeds=(0,), conditions=("tanh",))
    ).cells
    run_id = cell.run_id
    store.plan_run(run_id, run_identity(cell.run))
    words = ("run", "delete", run_id, "--yes", "--results", store.root)
    with run_lock(store.run_folder(run_id)):
        assert "is training now" in refused(*words)
    assert call(*words).code == 0 and store.runs() == []


def test_a_study_whose_runs_were_removed_while_it_trained_did_not_end_well(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local, "train_runs", lambda *_: None)
    code, out, _ = call("study", "run", "activation", *TINY, "--seeds", "1", "--results", store.root)
    assert code == 1 and "tanh seed 0 planned: " in out
