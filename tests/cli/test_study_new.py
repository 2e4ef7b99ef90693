"""`pneuma study new`: every shipped study is a start for one's own."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import list_studies, load_study

from .calls import printed


def test_a_copy_of_any_shipped_study_plans_the_same_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in list_studies():
        printed("study", "new", f"my-{name}", "--from", name)
        own, shipped = load_study(f"my-{name}.toml"), load_study(name)
        plans = [make_plan(study, Selection("quick")).cells for study in (own, shipped)]
        assert [cell.run_id for cell in plans[0]] == [cell.run_id for cell in plans[1]]
        assert (own.title, own.section, own.about) == (f"my-{name}", "", "")
