"""Evaluation: its scale, independence and worlds, and estimated values of actions against true ones."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pneuma.config import ACTIVATIONS, ENGINES, Run, make_run, stream_seed
from pneuma.engines.batched.initial_weights import initial_networks
from pneuma.engines.environment import make_vec_env
from pneuma.engines.evaluation import ActionValues, Evaluation, OwnAgent, evenness
from pneuma.engines.gymnasium_env import GymnasiumSlots
from pneuma.engines.loop import Trainer, evaluation_episodes, planned_evaluations
from pneuma.engines.policy import Policy
from pneuma.engines.records import Records, Row
from pneuma.env.players import Hunter
from pneuma.env.state import PLAYER
from pneuma.presets import BASES

from .test_backends import DEFINITIONS
from .trained import constant, train
from .trained import run_of as small_run


def run_of(**settings: object) -> Run:
    return make_run({**BASES["table-6-2"], "evaluation_episodes": 24, **settings})


@pytest.fixture(scope="module")
def evaluation() -> Evaluation:
    return Evaluation(run_of(seed=3))


def test_held_out_levels_are_none_that_is_trained_on() -> None:
    trained = run_of(level="random:train:0", random_levels=4)
    names = [
        {level.name for level in Evaluation(run).worlds.levels}
        for run in (trained, replace(trained, held_out_levels=3))
    ]
    assert names == [{f"random:train:{i}" for i in range(4)}, {f"random:test:{i}" for i in range(3)}]


def test_score_is_zero_for_the_random_player_and_one_where_all_are_killed(evaluation: Evaluation) -> None:
    row = evaluation.evaluate(constant([0.3, 0.1, 0.0, 0.2, 0.4], 60), 0)
    killed, at_random = row["share_killed"], row["random_share_killed"]
    assert 0 < at_random < 0.3 and killed != at_random
    assert row["score"] == pytest.approx((killed - at_random) / (1 - at_random))
    by_attacks_alone = evaluation.worlds.players["kills"][24:].sum(axis=1).mean() / 14  # its likeliest action
    assert by_attacks_alone != killed
    assert row["argmax_score"] == pytest.approx((by_attacks_alone - at_random) / (1 - at_random))


def test_a_certain_policy_plays_each_start_the_same_way_sampled_or_not(evaluation: Evaluation) -> None:
    # Nothing in the world is random but the start place, so episode lengths must agree by place.
    evaluation.evaluate(constant([50, 0, 0, 0, 0], 60), 100)  # always down
    worlds = evaluation.worlds.worlds
    by_place = dict(zip(worlds["start"][24:].tolist(), worlds["steps"][24:].tolist(), strict=True))
    assert worlds["steps"][:24].tolist() == [by_place[place] for place in worlds["start"][:24].tolist()]


def test_evaluating_again_gives_the_same_row_whatever_went_before(evaluation: Evaluation) -> None:
    policy = constant([0.3, 0.1, 0.0, 0.2, 0.4], 60)
    first = evaluation.evaluate(policy, 500)
    evaluation.evaluate(constant([1, 0, 0, 0, 0], 60), 600)
    np.random.seed(1)
    assert evaluation.evaluate(policy, 500) == first
    assert Evaluation(run_of(seed=3)).evaluate(policy, 500) == first
    assert Evaluation(run_of(seed=4)).evaluate(policy, 500) != first


def test_evaluation_worlds_are_none_of_the_training_worlds() -> None:
    run = run_of(seed=3, slots=16, minibatch=64)
    evaluation = Evaluation(run)
    evaluation.evaluate(constant([0, 0, 0, 0, 0], 60), 1)
    training = set(make_vec_env(run).worlds.worlds["key"].tolist())
    held_out = set(evaluation.worlds.worlds["key"].tolist())
    assert len(training) == 16
    assert not training & held_out


@pytest.mark.parametrize(
    ("steps", "horizon", "updates", "episodes"),
    [
        (100_352, 256, (19, 39, 58, 78, 98, 117, 137, 156, 176, 196), 50),  # at 5,017, 10,035, …
        (50_176, 256, (28, 56, 84, 112, 140, 168, 196), 10),  # one for each 8,000 steps, and one more
        (10_240, 256, (20, 40), 10),
        (24_576, 8192, (1, 2, 3), 50),  # no more updates than evaluations
        (4_096, 256, (1, 3, 4, 6, 8, 9, 11, 12, 14, 16), 10),  # at 409, 819, …
    ],
)
def test_evaluations_are_spread_evenly_and_follow_the_budget(
    steps: int, horizon: int, updates: tuple[int, ...], episodes: int
) -> None:
    run = make_run({"steps": steps, "horizon": horizon})
    planned = planned_evaluations(run)
    assert tuple(evaluation.updates for evaluation in planned[:10]) == updates
    assert (planned[-1].step, planned[-1].updates) == (steps, run.updates)
    assert evaluation_episodes(run) == episodes
    assert evaluation_episodes(replace(run, evaluation_episodes=30)) == 30
    elsewhere = replace(run, env="CartPole-v1", evaluation_episodes=30)
    assert (len(planned_evaluations(elsewhere)), evaluation_episodes(elsewhere)) == (min(20, run.updates), 30)


@pytest.mark.parametrize(
    ("steps", "horizon", "slots", "planned"),
    [  # by hand: at k nths of the budget, the updates that have ended by then
        (1000, 64, 2, {125: 0, 250: 1, 375: 2, 500: 3, 625: 4, 750: 5, 875: 6, 1000: 7}),  # 8 updates of 128
        (1000, 50, 2, {100: 1, 200: 2, 300: 3, 400: 4, 500: 5, 600: 6, 700: 7, 800: 8, 900: 9, 1000: 10}),
        (1000, 64, 1, {100: 1, 200: 3, 300: 4, 400: 6, 500: 7, 600: 9, 700: 10, 800: 12, 900: 14, 1000: 15}),
        (257, 256, 1, {128: 0, 257: 1}),
        (256, 256, 1, {256: 1}),
        (100, 256, 1, {100: 1}),  # less than an update: its only evaluation is after it
        (1, 256, 4, {1: 1}),
    ],
)
def test_the_policy_that_acts_at_a_step_is_evaluated_there_whatever_the_horizon(
    steps: int, horizon: int, slots: int, planned: dict[int, int]
) -> None:
    run = make_run({"steps": steps, "horizon": horizon, "slots": slots})
    assert {evaluation.step: evaluation.updates for evaluation in planned_evaluations(run)} == planned


def test_long_runs_share_twenty_steps_and_evaluate_no_policy_twice() -> None:
    for horizon in (2, 100, 256, 2048, 4096, 5000):
        run = make_run({"steps": 100_000, "horizon": horizon, "minibatch": 2})
        planned = planned_evaluations(run)
        assert [evaluation.step for evaluation in planned] == [5000 * k for k in range(1, 21)], horizon
        assert [evaluation.number for evaluation in planned] == [*range(1, 21)]
    for steps in (*range(1, 700), *range(99_990, 100_010)):
        planned = planned_evaluations(make_run({"steps": steps, "horizon": 64, "minibatch": 2}))
        updates = [evaluation.updates for evaluation in planned]
        assert updates == sorted(set(updates)) and planned[-1].step == steps


class Leaning(Trainer):
    """It pushes CartPole's cart to the side to which the pole falls, which makes episodes long."""

    def update(self, before: int, after: int, records: Records) -> bool:
        return True

    def evaluate(self, step: int) -> Row:
        row: Row = self._evaluation.evaluate(self.policy(), step)
        return row

    def policy(self) -> Policy:
        if self.run.env != "CartPole-v1":
            return constant([0, 1, 0], 6)
        lean = (np.array([[0.0, 0], [0, 0], [-9, 9], [-9, 9]], np.float32), np.zeros(2, np.float32))
        return Policy("tanh", (lean,), ())


@pytest.mark.parametrize(
    ("env", "steps", "evaluations", "episodes"),
    [("CartPole-v1", 10_240, 1, 10), ("CartPole-v1", 102_400, 6, 10), ("Acrobot-v1", 10_240, 1, 1)],
)
def test_evaluations_elsewhere_play_few_steps_compared_with_training(
    env: str, steps: int, evaluations: int, episodes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step of theirs costs less than half of one of training; no policy is as good as this one so early."""
    run = make_run({"env": env, "steps": steps})
    trainer, played, step_one = Leaning(run), [], GymnasiumSlots.step_one

    def counted_step(slots: GymnasiumSlots, *arguments: Any) -> Any:
        played.append(1)
        return step_one(slots, *arguments)

    monkeypatch.setattr(GymnasiumSlots, "step_one", counted_step)
    rows = [trainer.evaluate(evaluation.step) for evaluation in planned_evaluations(run)]
    assert [row["episodes"] for row in rows] == [episodes] * evaluations
    assert len(played) <= 0.6 * steps


def test_evenness_is_the_entropy_of_the_players_shares() -> None:
    none, one, both, uneven = (0, 0), (14, 0), (7, 7), (3, 1)
    assert evenness(np.array([one])) == 0
    assert evenness(np.array([both])) == pytest.approx(1)
    assert evenness(np.array([uneven])) == pytest.approx(0.811278)  # (3 log2 4/3 + log2 4) / 4 bits
    assert evenness(np.array([none, one, both])) == pytest.approx(0.5)  # where nobody kills there is none
    assert math.isnan(evenness(np.array([none])))


def test_steps_to_clear_and_hp_lost_are_those_of_the_episodes() -> None:
    """A hunter who knows all clears the level; every bite costs a bamboo's 7 HP."""
    run = make_run({"reward": "kills", "evaluation_episodes": 4, "end_on_clear": True})
    evaluation = Evaluation(run)
    hunter = Hunter(evaluation.worlds)
    lost = np.zeros(len(evaluation.worlds))

    def act(observations: np.ndarray) -> np.ndarray:
        lost[:] += evaluation.worlds.events["hp_lost"].sum(axis=1)
        return hunter.act(evaluation.worlds).reshape(-1)[:4]

    row = evaluation.evaluate(OwnAgent(act, None, 5), 0)
    lost += evaluation.worlds.events["hp_lost"].sum(axis=1)
    assert row["share_killed"] == 1.0
    assert row["steps_to_clear"] == pytest.approx(row["length"])
    assert row["hp_lost"] == pytest.approx(lost[:4].mean()) and row["hp_lost"] % (7 / 4) == pytest.approx(0)


@pytest.mark.parametrize("players", [1, 2])
def test_the_commonest_action_is_counted_over_all_steps_of_the_sampled_episodes(
    players: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By hand: the actions that a player was alive to take. Down is drawn in 6 of 10 steps, or nearly."""
    run = run_of(seed=5, players=players, episode_steps=300, evaluation_episodes=8)
    evaluation = Evaluation(run)
    counts, advance = np.zeros(5), evaluation.worlds.advance

    def counting(actions: np.ndarray) -> int:
        ended = advance(actions)
        np.add.at(counts, actions[:8][evaluation.worlds.present[:8]], 1)
        return ended

    monkeypatch.setattr(evaluation.worlds, "advance", counting)
    policy = constant([math.log(12), math.log(2), math.log(2), math.log(2), math.log(2)], 60)
    share = evaluation.evaluate(policy, 7)["commonest_action"]
    assert share == counts.max() / counts.sum() == counts[0] / counts.sum()
    assert share == pytest.approx(0.6, abs=0.05)


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("players", [1, 2])
def test_compiled_play_is_what_numpy_plays(activation: str, players: int) -> None:
    run = run_of(seed=5, players=players, episode_steps=200, activation=activation)
    evaluation = Evaluation(run)
    networks = initial_networks(run, 60, 5)
    sharp = tuple((weight * np.float32(3), bias) for weight, bias in networks["actor"])
    policy = Policy(activation, sharp, networks["critic"])
    compiled = evaluation.evaluate(policy, 7)
    generator = np.random.default_rng(stream_seed(run.seed, "evaluation-actions", 7))

    def sample(observations: np.ndarray) -> np.ndarray:
        weights = np.exp(numpy_logits(policy, observations)).cumsum(axis=1)
        draws = generator.random(len(observations), np.float32) * weights[:, -1]
        return (weights <= draws[:, None]).sum(axis=1)

    agent = OwnAgent(sample, lambda observations: numpy_logits(policy, observations).argmax(axis=1), 5)
    assert evaluation.evaluate(agent, 7) == pytest.approx(compiled)
    assert compiled["length"] > 10


def numpy_logits(policy: Policy, observations: np.ndarray) -> np.ndarray:
    """Return the logits of a policy of one hidden layer, in double precision."""
    (weight, bias), (last_weight, last_bias) = policy.actor
    hidden = observations.astype(float) @ weight + bias
    outputs = np.vectorize(DEFINITIONS[policy.activation])(hidden)
    return np.asarray(outputs @ last_weight + last_bias)


# --- XP that is never reset -------------------------------------------------------------------------


def first_xp(patch: pytest.MonkeyPatch) -> list[list[list[float]]]:
    """Return a list to which every play adds the XP with which its episodes begin, (worlds, players)."""
    begun: list[list[list[float]]] = []
    play = Evaluation._play

    def watched(evaluation: Evaluation, choose_actions: Any, *more: Any) -> None:
        seen: list[list[list[float]]] = []

        def watching(is_playing: np.ndarray) -> np.ndarray:
            seen.append(evaluation.worlds.players["xp"].tolist())
            actions: np.ndarray = choose_actions(is_playing)
            return actions

        play(evaluation, watching, *more)
        begun.append(seen[0])

    patch.setattr(Evaluation, "_play", watched)
    return begun


def test_worlds_take_the_xp_of_training_worlds_in_turn_and_draw_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = run_of(env="pneuma/PneumaGodot-v0", players=2, slots=2, evaluation_episodes=4, episode_steps=40)
    evaluation = Evaluation(run)
    policy = constant([0.3, 0.1, 0.0, 0.2, 0.4], evaluation.worlds.observations.shape[2])
    begun = first_xp(monkeypatch)
    without = evaluation.evaluate(policy, 100)
    with_xp = evaluation.evaluate(policy, 100, np.array([[5.0, 6.0], [7.0, 8.0], [9.0, 10.0]]))
    assert begun[0] == [[0, 0]] * len(evaluation.worlds)
    in_turn = [[5, 6], [7, 8], [9, 10]] * len(evaluation.worlds)
    assert begun[1] == in_turn[: len(evaluation.worlds)]
    # This policy does not look at XP: it plays the same episodes.
    unlike = {name for name, value in with_xp.items() if value != without[name]}
    assert unlike <= {"return", "argmax_return"}


def test_estimated_values_are_of_states_with_the_xp_of_training(monkeypatch: pytest.MonkeyPatch) -> None:
    """The policy's greatest value is the XP that it observes, and nobody kills or ends within two steps."""
    run = run_of(env="pneuma/PneumaGodot-v0", algorithm="dqn", episode_steps=2, gamma=0.5)
    values = ActionValues(run, 1)
    features = values.worlds.observations.shape[2]
    weight = np.zeros((features, 5), np.float32)
    weight[3, 4] = 1.0
    policy = Policy("tanh", ((weight, np.zeros(5, np.float32)),), (), exploration=0.1)
    assert values.measure(policy, np.array([[6.0], [99.0]]))["q_estimate"] == 6.0
    assert values.measure(policy)["q_estimate"] == 0.0


@pytest.mark.parametrize("engine", ENGINES)
def test_evaluations_begin_with_the_xp_of_the_slots_where_it_is_never_reset(
    engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a checkpoint of the same update has it; elsewhere with 0."""
    for env, is_kept in (("pneuma/PneumaGodot-v0", True), ("pneuma/PneumaArena-v0", False)):
        with monkeypatch.context() as patch:
            begun = first_xp(patch)
            _, checkpoints = train(small_run("slots", env=env, engine=engine))
        at_random, *evaluated = begun
        zeros = [[0.0]] * len(at_random)
        assert at_random == zeros and len(evaluated) == len(checkpoints) == 6
        if not is_kept:
            assert evaluated == [zeros] * 6
            continue
        for checkpoint, worlds_xp in zip(checkpoints, evaluated, strict=True):
            slots_xp = checkpoint.arrays["worlds/players"].view(PLAYER)["xp"].tolist()
            assert worlds_xp == [[slots_xp[world % 2]] for world in range(len(worlds_xp))]
        assert any(slots_xp)


# --- Estimated and true values of actions ---------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.0, 0.5, 0.9])
def test_a_constant_reward_is_worth_the_geometric_series(
    gamma: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The time limit cuts no state short: all are worth 1 / (1 - gamma), except the hundredth left out."""
    values = ActionValues(make_run({"algorithm": "dqn", "gamma": gamma, "episode_steps": 12}), 6)
    step = values.worlds.step

    def paid(actions: np.ndarray) -> int:
        ended = step(actions)
        values.worlds.events["reward"][:] = values.worlds.present
        return ended

    monkeypatch.setattr(values.worlds, "step", paid)
    row = values.measure(constant([0, 7, 0, 0, 0], 60, critic=(), exploration=0.1))
    assert row["q_estimate"] == 7.0
    assert row["q_true"] == pytest.approx(1 / (1 - gamma), rel=0.011)
    assert row["q_true"] <= 1 / (1 - gamma)
