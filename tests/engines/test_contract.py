"""What both engines must do alike, for every network of thesis section 6."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.algorithms import ALGORITHMS
from pneuma.analysis.outcomes import ONLY_ELSEWHERE, ONLY_IN_PNEUMA
from pneuma.config import Run, env_config, make_run, slot_seeds
from pneuma.engines import evaluation, gymnasium_evaluation
from pneuma.engines.batched.training import BatchedTrainer
from pneuma.engines.gymnasium_env import GymnasiumSlots
from pneuma.engines.loop import Progress, Result, ResumableTrainer, train_run
from pneuma.engines.policy import Policy
from pneuma.engines.records import (
    EPISODE_COLUMNS,
    EVALUATION_COLUMNS,
    METRIC_COLUMNS,
    VALUE_COLUMNS,
    has_finite_losses,
)
from pneuma.engines.sb3 import Sb3Trainer
from pneuma.env.slots import LearnerSlots, make_slots

from ..env.arena import EMPTY
from .trained import constant, run_of, train

ENGINES = ALGORITHMS["ppo"].engines
BIG = pytest.param((1024, 1024), (4096, 4096, 4096, 4096), marks=pytest.mark.slow)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("actor", "critic"), [((128,), (256,)), BIG])
def test_one_update_of_every_network(actor: tuple[int, ...], critic: tuple[int, ...], engine: str) -> None:
    """One epoch of one minibatch, so that a mean of squares is the square, from an almost even policy."""
    one = {"horizon": 64, "minibatch": 64, "epochs": 1, "steps": 64, "evaluation_episodes": 1}
    run = make_run({**one, "episode_steps": 30, "actor": actor, "critic": critic, "engine": engine})
    result, checkpoints = train(run)
    assert (result.status, result.step, len(checkpoints)) == ("done", 64, 1)
    assert isinstance(result.policy, Policy)
    for layers, hidden, outputs in ((result.policy.actor, actor, 5), (result.policy.critic, critic, 1)):
        assert [weight.shape for weight, _ in layers] == list(
            zip((60, *hidden), (*hidden, outputs), strict=True)
        )
        assert all(np.isfinite(part).all() and part.dtype == np.float32 for layer in layers for part in layer)
    (row,) = result.records.metrics
    assert set(row) == set(METRIC_COLUMNS)
    assert row["grad_norm"] ** 2 == pytest.approx(
        row["grad_norm_actor"] ** 2 + row["grad_norm_critic"] ** 2, rel=1e-4
    )
    assert row["entropy"] == pytest.approx(math.log(5), abs=0.01)  # the actor's head has gain 0.01
    assert sum(row[f"action_{i}"] for i in range(5)) == pytest.approx(1)
    assert [(own["step"], own["length"]) for own in result.records.episodes] == [(30, 30), (60, 30)]
    assert set(result.records.episodes[0]) == set(EPISODE_COLUMNS)
    assert [set(own) for own in result.records.evaluations] == [
        {*EVALUATION_COLUMNS, "steps_to_clear", "hp_lost", "commonest_action"}
    ]


@pytest.mark.parametrize("engine", ENGINES)
def test_episodes_of_slots_add_up_to_the_steps_of_all(engine: str) -> None:
    result, _ = train(run_of(slots=2, horizon=32, episode_steps=40, engine=engine))
    assert [row["step"] for row in result.records.metrics] == [64, 128, 192, 256, 320, 384]
    for slot in range(2):
        episodes = [row for row in result.records.episodes if row["slot"] == slot]
        lengths = np.cumsum([row["length"] for row in episodes])
        # An episode of a slot ends when all slots together have taken twice its slot's steps.
        assert episodes and [row["step"] for row in episodes] == (2 * lengths).tolist()
        assert [row["episode"] for row in episodes] == list(range(len(episodes)))
        assert max(row["length"] for row in episodes) <= 40
    for row in result.records.episodes:
        assert row["ending"] in ("killed", "time-limit")
        assert (row["hp"] == 0) == (row["ending"] == "killed")
    assert [row["step"] for row in result.records.evaluations] == [64, 128, 192, 256, 320, 384]


def stopped_at(run: Run, end: int) -> Result:
    return train_run(run, lambda progress: progress.step < end)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_budget_within_an_update_is_trained_to_its_end_and_each_policy_is_evaluated_where_it_acts(
    engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 350 steps: six updates of 64 end at 64, 128, …, 384, and sixths of the budget are 58, 116, …"""
    evaluated: dict[int, str] = {}
    evaluate = evaluation.Evaluation.evaluate

    def watched(self: Any, policy: Policy, step: int, *more: Any) -> dict[str, Any]:
        evaluated[step] = policy.checksum
        return evaluate(self, policy, step, *more)

    monkeypatch.setattr(evaluation.Evaluation, "evaluate", watched)
    run = run_of(steps=350, engine=engine, learning_rate_schedule="linear")
    seen: dict[int, list[int]] = {}

    def note(progress: Progress) -> bool:
        seen[progress.step] = [row["step"] for row in progress.records.evaluations]
        return True

    result = train_run(run, note)
    steps = [58, 116, 175, 233, 291, 350]
    assert (result.status, result.step, run.steps) == ("done", 384, 350)
    assert seen == {
        64: steps[:2], 128: steps[:3], 192: steps[:4], 256: steps[:5], 320: steps, 384: steps,
    }  # fmt: skip
    trainer: dict[str, type[ResumableTrainer]] = {"batched": BatchedTrainer, "sb3": Sb3Trainer}
    policies: list[Any] = [trainer[engine](run).policy()]
    for end in [*seen][:-1]:
        policies.append(stopped_at(run, end).policy)
    assert [evaluated[step] for step in steps] == [policy.checksum for policy in policies]
    # At the end of the last update the learning rate is 0.
    assert isinstance(result.policy, Policy) and result.policy.checksum == policies[-1].checksum


def slots_of(run: Run) -> LearnerSlots:
    if run.env == "Corridor-v0":
        return GymnasiumSlots(run, slot_seeds(run), training=True)
    slots = make_slots(run.slots, env_config(run))
    slots.worlds.seed(slot_seeds(run))
    slots.worlds.reset()
    slots.has_begun = True
    return slots


@pytest.mark.parametrize("case", ["slots", "corridor"])
def test_slots_of_both_kinds_are_what_learners_take(case: str) -> None:
    """A step ends what it says, and a state that was saved goes on as if nothing had happened."""
    run, generator = run_of(case), np.random.default_rng(0)
    slots = slots_of(run)

    def play(slots: LearnerSlots, actions: np.ndarray) -> list[Any]:
        begins, ended = slots.begins.copy(), slots.step(actions)
        assert (slots.terminated | slots.truncated == ended).all()
        assert not (slots.terminated & slots.truncated).any()
        assert slots.rewards.dtype == np.float64 and slots.observations.dtype == np.float32
        return [slots.observations.tolist(), slots.rewards.tolist(), ended.tolist(), begins.tolist()]

    actions = generator.integers(2, size=(40, run.slots))
    for step_actions in actions[:20]:
        play(slots, step_actions)
    saved, resumed = slots.saved_state(), slots_of(run)
    resumed.restore_state(saved)
    for step_actions in actions[20:]:
        assert play(resumed, step_actions) == play(slots, step_actions)


OF_TWO_PLAYERS: dict[str, float] = {
    "step": 7, "episodes": 4, "share_killed": 0.5, "score": 1 / 3, "return": (9.93 - 0.07) / 2, "length": 3,
    "died": 0, "argmax_starts": 1, "argmax_share_killed": 0.5, "argmax_score": 1 / 3,
    "argmax_return": (9.93 - 0.07) / 2, "random_share_killed": 0.25, "steps_to_clear": 3, "hp_lost": 7,
    "commonest_action": 1, "kill_evenness": 0,
}  # fmt: skip
"""Two players strike a squid below them, one of two monsters; the first kills it, for 10 XP. The bamboo above
bites both once, for 7 of 100 HP. The random player's share is set: a score is (1/2 - 1/4) / (3/4)."""
OF_VALUES: dict[str, float] = {"q_estimate": 7, "q_true": 9.93 / 3}
"""Of one player there, whose best action always has the value 7: nothing is earned after the first step."""
ELSEWHERE: dict[str, float] = {
    "step": 7, "episodes": 2, "return": 2, "length": 1, "argmax_starts": 5, "argmax_return": 2, "success": 0,
    "random_return": 2, "random_spread": 0,
}  # fmt: skip
"""In an environment that pays 2 for the only step of each episode, and never reports success."""


def test_each_column_of_an_evaluation_has_its_value_by_hand(tmp_path: Path) -> None:
    monsters = (("squid", 0.0, 50.0), ("bamboo", 0.0, -60.0))
    level = replace(EMPTY, starts=((0.0, 0.0),), monsters=monsters).write(tmp_path)
    there: dict[str, Any] = {"level": level, "reward": "kills", "episode_steps": 3, "evaluation_episodes": 4}
    two = evaluation.Evaluation(run_of(**there, players=2, horizon=32))
    two.random_share = 0.25
    row = two.evaluate(constant([0, 0, 0, 0, 99], 12), 7)
    assert row == pytest.approx(OF_TWO_PLAYERS)
    one = evaluation.Evaluation(run_of("dqn", **there, time_limit="terminate", gamma=0.5))
    values = one.evaluate(constant([0, 0, 0, 0, 7], 12, critic=(), exploration=0.0), 7)
    assert {column: values[column] for column in values.keys() - row.keys()} == pytest.approx(OF_VALUES)
    wrappers = ["tests.engines.own_envs:Counting", "tests.engines.own_envs:Doubled"]
    last = {"name": "TimeLimit", "max_episode_steps": 1}
    corridor = run_of(env="Corridor-v0", env_module="tests.engines.own_envs", wrappers=[*wrappers, last])
    other = gymnasium_evaluation.Evaluation(corridor).evaluate(constant([-9, 9], 2), 7)
    assert {column: value for column, value in other.items() if not math.isnan(value)} == ELSEWHERE
    columns = {*EVALUATION_COLUMNS, *VALUE_COLUMNS}
    assert columns == OF_TWO_PLAYERS.keys() | OF_VALUES.keys() | ELSEWHERE.keys()


def test_evaluations_have_the_declared_columns_and_each_is_of_the_worlds_that_record_it() -> None:
    """Two players have all columns of Pneuma's worlds but those of learners that estimate values."""
    five, values = constant([0, 1, 0, 0, 0], 60), constant([0, 1, 0, 0, 0], 60, critic=(), exploration=0.1)
    in_pneuma = {*evaluation.Evaluation(run_of("players")).evaluate(five, 0)}
    in_pneuma |= {*evaluation.Evaluation(run_of("dqn")).evaluate(values, 0)}
    corridor = run_of(env="Corridor-v0", env_module="tests.engines.own_envs")
    row = gymnasium_evaluation.Evaluation(corridor).evaluate(constant([-9, 9], 2), 0)
    elsewhere = {column for column, value in row.items() if not math.isnan(value)}
    assert in_pneuma | {*row} == {*EVALUATION_COLUMNS, *VALUE_COLUMNS}
    assert in_pneuma - elsewhere == {*ONLY_IN_PNEUMA} - {"hp", "kills"}  # of training's episodes
    assert elsewhere - in_pneuma == {*ONLY_ELSEWHERE}


def test_a_run_diverges_by_a_loss_and_not_by_a_variance_that_is_undefined() -> None:
    assert has_finite_losses({"value_loss": 1.0, "explained_variance": math.nan})
    assert not has_finite_losses({"value_loss": math.inf, "entropy": 1.0})
