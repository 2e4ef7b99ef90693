"""Studies of several environments: scores by hand, a panel each, and what cannot be scaled."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

import pytest
from PIL import Image

from pneuma.analysis.curves import find_curves
from pneuma.analysis.drawing import drawing_of
from pneuma.analysis.environments import (
    by_environment,
    columns_of,
    environment_names,
    profile_scores,
    profiles,
)
from pneuma.analysis.summaries import show_outcomes
from pneuma.api import open_data
from pneuma.cli.study_files import FACTORS, FIGURE_KINDS
from pneuma.config import as_fields
from pneuma.figures.curves import curves_page
from pneuma.figures.grid import Page, Panel
from pneuma.figures.summary import summary_page
from pneuma.figures.words import looks_of
from pneuma.store.store import Store
from pneuma.study.identity import config_id, run_id
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study

from ..hand_made import save_run, write_table
from .calls import call, printed, refused

TOML = """
title = "Two"
[factors.env]
pole = { env = "CartPole-v1" }
arms = { env = "Acrobot-v1" }
[factors.algorithm]
ppo = { algorithm = "ppo" }
a2c = { algorithm = "a2c" }
[scores.CartPole-v1]
random = 0
expert = 100
[scores.Acrobot-v1]
random = -500
expert = -100
[presets.quick]
seeds = 4
steps = 4_096
"""
RETURNED = {"pole, ppo": 100, "pole, a2c": 50, "arms, ppo": -200, "arms, a2c": -400}
RANDOM = {"random_return": 20.0, "random_spread": 5.0}


def save_two_environments(path: Path, random: Mapping[str, float] = RANDOM, toml: str = TOML) -> None:
    """Write a study with runs that return what `RETURNED` says in their only evaluation, and up to 3 more."""
    path.write_text(toml)
    store = Store(path.parent / "results")
    plan = make_plan(load_study(str(path)), Query())
    for cell in plan.cells:
        step = cell.run.steps
        evaluated = {"step": step, "return": RETURNED.get(cell.condition, 0) + cell.seed, **random}
        evaluated["commonest_action"] = 0.5
        fields, config = as_fields(cell.run), config_id(cell.run)
        episode = [{"step": step, "episode": 0, "return": 1.0}]
        save_run(store, run_id(cell.run), episode, [], [evaluated], step, "done", fields, config)


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study with the runs of `save_two_environments`."""
    monkeypatch.chdir(tmp_path)
    save_two_environments(tmp_path / "two.toml")
    return tmp_path / "two.toml"


def test_summary_has_a_column_for_each_environment_and_scores_over_all(study: Path) -> None:
    document = call("study", "summary", study, "--json").document
    means = {(row["condition"], row["environment"]): row["value"] for row in document["summary"]}
    assert means == {  # of seeds 0 to 3
        ("ppo", "CartPole-v1"): 101.5, ("a2c", "CartPole-v1"): 51.5,
        ("ppo", "Acrobot-v1"): -198.5, ("a2c", "Acrobot-v1"): -398.5,
    }  # fmt: skip
    scores = {(row["condition"], row["statistic"]): row["value"] for row in document["scores"]}
    assert scores["ppo", "mean"] == pytest.approx((1.015 + 301.5 / 400) / 2)
    assert scores["a2c", "mean"] == pytest.approx((0.515 + 101.5 / 400) / 2)
    gap = 1 - (4 * 1.0 + 4 * 301.5 / 400) / 8  # above 1 counts as 1
    assert scores["ppo", "optimality gap"] == pytest.approx(gap)


def test_tables_and_panels_call_environments_by_the_factors_values(study: Path) -> None:
    """JSON's means and comparisons keep the ids."""
    study.write_text(TOML.replace("[presets.quick]", '[labels]\narms = "Two arms"\n[presets.quick]'))
    summary = printed("study", "summary", study, "--format", "markdown").splitlines()
    assert summary[0].startswith("| condition | runs | pole | Two arms | mean ")
    compared = printed("study", "compare", study, "ppo", "a2c")
    assert "pole         evaluated-return" in compared and "Two arms     evaluated-return" in compared
    planned = printed("study", "plan", study, "--detect", "2", "--outcome", "evaluated-return")
    assert "\nTwo arms" in planned and "Acrobot" not in planned
    page = curves_page(find_curves(columns_of(open_data(study)), ["evaluated_return"]))
    assert [panel.title for panel in _panels(page)] == ["pole", "Two arms"]


def test_two_values_of_one_environment_leave_it_its_id(study: Path) -> None:
    study.write_text(
        TOML.replace(
            "[factors.algorithm]", 'pole2 = { env = "CartPole-v1", gamma = 0.9 }\n[factors.algorithm]'
        )
    )
    assert environment_names(open_data(study)) == {env: env for env in ("CartPole-v1", "Acrobot-v1")}


def test_without_a_scale_the_environments_are_shown_and_the_hint_is_toml(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where no random player was recorded: in Pneuma's worlds."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "two.toml"
    save_two_environments(path, {})
    given = TOML.index("[scores.CartPole-v1]"), TOML.index("[presets.quick]")
    path.write_text(TOML[: given[0]] + TOML[given[1] :])
    for command in (("study", "summary", path), ("study", "compare", path, "ppo", "a2c")):
        called = call(*command)
        assert called.code == 0 and "102" in called.out and "-398" in called.out
        (hint,) = re.findall(r'(".*" = .*) under \[scores\]', called.out + called.err)
        read = tomllib.loads(f"[scores]\n{hint.replace('…', '1')}")
        assert read == {"scores": {"CartPole-v1": {"random": 1, "expert": 1}}}
        assert "scores" not in call(*command, "--json").document


def test_all_cells_of_a_paper_have_intervals_as_scores_have_no_deviation(study: Path) -> None:
    """Of four runs in an environment there is no interval of the mean, but a bootstrap of the scores."""
    _, _, row, _ = printed("study", "summary", study, "--format", "markdown").splitlines()
    assert row.startswith("| ppo | 4, 4 | 102 | -198 | 0.8844 [0.8787 to ")
    called = call("study", "summary", study, "--format", "latex", "--cells", "sd")
    assert called.code == 2 and "--cells sd: scores over environments have no standard" in called.err


def test_compare_takes_conditions_in_each_environment_and_over_all(study: Path) -> None:
    document = call("study", "compare", study, "ppo", "a2c", "--json").document
    differences = {row["environment"]: row["difference"] for row in document["comparisons"]}
    assert differences == {"CartPole-v1": 50, "Acrobot-v1": 200}
    over = {row["statistic"]: row for row in document["scores"]}
    assert over["P(better)"]["value"] == over["P(better)"]["low"] == 1  # every run is above every other
    assert over["mean, difference"]["value"] == pytest.approx((0.5 + 0.5) / 2)


def test_a_figure_has_a_panel_for_each_environment(study: Path) -> None:
    plot = ("study", "plot", study, "--quantity", "evaluated_return")
    printed(*plot, "--out", "two.svg")
    assert Path("two.svg").read_text().count('<g id="axes_') == 2
    printed(*plot, "--out", "two.png")
    with Image.open("two.png") as image:
        _, *lines = image.info["Description"].splitlines()
    conditions = [line.partition(", seeds")[0] for line in lines]
    assert conditions == [f"two, {condition}" for condition in RETURNED]


SHOWN = {
    "curves": "Return in training",
    "summary": "Return of an episode",
    "profile": "Share of runs above it",
    "one-action": "Not yet staying in one action",
}
"""Words that stand on figures of each kind alone."""


@pytest.mark.parametrize("kind", SHOWN)
def test_a_kind_of_figure_is_drawn_and_no_other(study: Path, kind: str) -> None:
    """That of factors has a study of its own (`analysis/test_factors.py`)."""
    assert {*SHOWN, FACTORS} == {*FIGURE_KINDS}
    printed("study", "plot", study, "--figure", kind, "--out", "drawn.svg")
    drawn = Path("drawn.svg").read_text()
    assert [other for other, words in SHOWN.items() if words in drawn] == [kind]


def test_a_figure_that_cannot_be_drawn_or_written_is_refused(study: Path) -> None:
    plot = ("study", "plot", study)
    assert "leave out --format: two.svg names it" in refused(*plot, "--out", "two.svg", "--format", "png")
    assert "a figure's file must end in .png, .svg, .pdf" in refused(*plot, "--out", "two.jpg")
    called = call(*plot, "--quantity", "success")
    assert called.code == 2 and "'success'; known are" in called.err
    assert not [*Path().glob("two.*g")]


@pytest.mark.parametrize(("in_each", "code"), [(7, 0), (8, 2)])
def test_a_panel_has_seven_conditions_at_most_and_a_study_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, in_each: int, code: int
) -> None:
    """Conditions that are not crossed have names of their own in each environment."""
    monkeypatch.chdir(tmp_path)
    conditions = [
        f'{env[:4]}{number} = {{ env = "{env}", gamma = 0.9{number} }}'
        for env in ("CartPole-v1", "Acrobot-v1")
        for number in range(in_each)
    ]
    toml = "\n".join(['title = "Many"', "[conditions]", *conditions, TOML[TOML.index("[presets") :]])
    save_two_environments(tmp_path / "many.toml", toml=toml.replace("seeds = 4", "seeds = 1"))
    called = call("study", "plot", "many.toml", "--figure", "curves", "--out", "many.svg")
    assert (called.code, "too many conditions for one panel" in called.err) == (code, code == 2)


def test_panels_have_the_evaluated_return_and_their_own_names_of_conditions(study: Path) -> None:
    parts = by_environment(open_data(study))
    usual, trained = (
        curves_page(find_curves(parts, [quantity])) for quantity in ("evaluated_return", "return")
    )
    summary = summary_page(show_outcomes(parts))
    assert [panel.title for panel in _panels(usual)[:2]] == ["CartPole-v1", "Acrobot-v1"]
    assert _panels(usual)[0].y == "Return in evaluation" and _panels(trained)[0].y == "Return in training"
    assert _panels(summary)[0].rows == ["ppo (4)", "a2c (4)"]
    assert "The conditions were trained by different engines: batched (ppo), sb3 (a2c)." in summary.caption


def _panels(page: Page) -> list[Panel]:
    return [panel for row in page.grid for panel in row if panel]


def test_a_figure_notes_what_logs_in_it_average(study: Path) -> None:
    """They have no evaluations, and their environment is not recorded: they are in both panels."""
    write_table(Path("logs.csv"), {("tanh", 0): {10: 1.0, 20: 2.0}})
    words = ("import", "csv", "logs.csv", "--step", "step", "--value", "return")
    mean = "logs: mean of the last 100 episodes."
    for averaged, note in (((), "logs: as logged."), (("--averaged-over", "100"), mean)):
        printed(*words, *averaged)
        page = curves_page(find_curves(by_environment(open_data(study)), beside=open_data("logs")))
        assert _panels(page)[0].y == "Return in training"
        assert f"{note} The environment of logs is not recorded." in page.caption
    plot = ("study", "plot", study, "--out", "beside.png", "--beside", "logs")
    assert call(*plot).code == 0
    assert "--beside takes one study" in call(*plot, "--beside", "two").err


def test_the_best_run_is_one_of_the_environment(study: Path) -> None:
    words = ("--player", f"best:{study}", "--out", "x.gif")
    cells = make_plan(load_study(str(study)), Query()).cells
    (best,) = (run_id(cell.run) for cell in cells if (cell.condition, cell.seed) == ("pole, ppo", 3))
    assert best in call("env", "render", "CartPole-v1", *words).err  # it has no policy
    message = call("env", "render", "Pendulum-v1", *words).err
    assert "was trained in CartPole-v1 and Acrobot-v1, not in Pendulum-v1" in message


def test_a_profile_is_of_the_runs_of_all_environments(study: Path) -> None:
    """Of scores around 1 and 3/4 (ppo), and 1/2 and 1/4 (a2c), eight runs each."""
    data = by_environment(open_data(study))
    shares = profiles(data).set_index("condition")
    above = {name: of.set_index("x")["share"] for name, of in shares.groupby("condition")}
    for name, at, share in (("ppo", 0.5, 1), ("ppo", 0.9, 0.5), ("a2c", 0.4, 0.5), ("a2c", 0.9, 0)):
        assert above[name][above[name].index >= at].iloc[0] == share
    assert (
        "0 and 1 are 0 and 100 in CartPole-v1, −500 and −100 in Acrobot-v1."
        in profile_scores(open_data(study)).notes[0]
    )
    called = call("study", "plot", "activation", "--figure", "profile")
    assert (called.code, "is over several environments; activation has one" in called.err) == (2, True)


def test_a_scale_of_nothing_is_refused(study: Path) -> None:
    study.write_text(TOML.replace("expert = 100", "expert = 0"))
    assert "expert (0) must be above random (0)" in refused("study", "summary", study)


def test_factors_values_have_labels_and_colours(study: Path) -> None:
    """Each combination has those of its parts, unless it has its own."""
    table = '[labels]\nppo = "PPO"\n[colors]\nppo = "C3"\n"arms, ppo" = "C4"\n[presets.quick]'
    study.write_text(TOML.replace("[presets.quick]", table))
    data = open_data(study)
    assert data.study.labels["pole, ppo"] == "pole, PPO"
    colours = {name: look["color"] for name, look in looks_of(drawing_of({"": data})).items()}
    assert (colours["pole, ppo"], colours["arms, ppo"]) == ("C3", "C4")
    pole, arms = by_environment(data).values()
    assert [looks_of(drawing_of({"": part}))["ppo"]["color"] for part in (pole, arms)] == ["C3", "C4"]
    assert pole.study.labels["ppo"] == "PPO"
    study.write_text(TOML.replace("[presets.quick]", '[colors]\nsac = "C3"\n[presets.quick]'))
    assert "unknown condition 'sac'" in refused("study", "summary", study)


def test_how_many_seeds_find_a_difference(study: Path) -> None:
    words = ("study", "plan", study, "--detect", "2", "--outcome", "evaluated-return", "--json")
    rows = call(*words).document["seeds"]
    assert {row["runs"] for row in rows} == {"4 and 4"}
