"""`pneuma env …`: list and draw environments."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import options as opt
from pneuma.cli.output import Result, check_file, rows_result, say, write_file
from pneuma.env.fields import ENVIRONMENTS
from pneuma.errors import UserError, counted, unknown_name
from pneuma.presets import WORLDS

if TYPE_CHECKING:
    from pneuma.engines.policy import Policy
    from pneuma.engines.sb3_open import LearnedPolicy
    from pneuma.env.worlds import Worlds

app = opt.Commands("env", "List and draw environments.")

ABOUT = {
    "pneuma/Pneuma-v0": "the thesis's text, well posed: unit-scale observations, 1,000 steps",
    "pneuma/PneumaGodot-v0": "its published code with the quirks: raw pixels, rewarded events, XP for ever",
    "pneuma/PneumaArena-v0": "the text's rules, rewarded for XP gained minus HP lost, the facing observed",
}
"""A description of each environment."""

RANDOM, HUNTER = "random", "hunter"
BEST = "best:"

Environment = Annotated[str, opt.argument("ID", "An environment's id, as in `pneuma env list`.")]
Seed = Annotated[int, opt.option("N", "Seed of the world.", min=0)]


@app.command("list")
def list_() -> Result:
    """List the environments and what they are."""
    import gymnasium

    rows: list[dict[str, Any]] = []
    for env_id in ENVIRONMENTS:
        with closing(gymnasium.make(env_id).unwrapped) as env:
            observation = str(env.observation_space.shape or env.observation_space)
            actions = int(env.action_space.n)  # type: ignore[attr-defined]
        rows.append({"id": env_id, "observation": observation, "actions": actions, "about": ABOUT[env_id]})
    return rows_result("environments", rows)


@app.command()
def render(
    name: Environment,
    out: Annotated[Path, opt.option("FILE", "The .png to write, or a .gif of an episode.")],
    player: Annotated[
        str, opt.option("AGENT", "Agent: random, hunter, a run id, or best:STUDY, its best run.")
    ] = RANDOM,
    seed: Seed = 0,
    seconds: Annotated[float, opt.option("N", "Longest episode in a .gif, in seconds.", min=1.0)] = 20.0,
    set_: opt.Settings = None,
    trust: opt.Trust = False,
    results: opt.Results = opt.HERE,
) -> Result:
    """Draw an environment as a picture, or an episode as an animation.

    A .gif shows the first --seconds of an episode and ends two seconds after the last monster's death. A
    run's policy plays in the environment that it was trained in, changed by --set. Environments that are
    not Pneuma's are drawn by their own render method.
    """
    from pneuma.config import WORLD_FIELDS, is_gymnasium_id, make_run
    from pneuma.env import watch

    check_file(out, (".gif", ".png"))
    is_moving = out.suffix.lower() == ".gif"
    if player != RANDOM and not is_moving:
        raise UserError(f"--player {player} plays an episode, but {out} is a picture: name a .gif")
    is_own = not is_gymnasium_id(name)
    if is_own and name not in ENVIRONMENTS:
        raise unknown_name("environment", name, ENVIRONMENTS)
    if not is_own and (player == HUNTER or set_):
        raise UserError(f"--player hunter and --set work only in Pneuma's environments, not in {name}")
    policy: Policy | LearnedPolicy | None = None
    settings: dict[str, Any] = {"env": name}
    if player not in (RANDOM, HUNTER):
        policy, settings = _load_player(player, name, results, trust)
    if not is_own:
        from pneuma.engines.gymnasium_frames import episode_frames, frame_rate
        from pneuma.store.stored_runs import stored_run

        run = stored_run(settings) if policy else make_run(settings)
        frames = episode_frames(run, policy, seed)
        if is_moving:
            rate = frame_rate(run)
            write_file(out, watch.encode_gif(islice(frames, round(seconds * rate)), rate))
        else:
            write_file(out, watch.encode_png(next(frames)))
        return Result({"file": out}, [f"wrote {out}"])
    import numpy as np

    from pneuma.engines.policy import Policy, action_sampler
    from pneuma.env.fields import REWARDS, make_env_config
    from pneuma.env.players import Hunter, RandomPlayer
    from pneuma.env.render import GIF_FACTOR, Renderer
    from pneuma.env.worlds import Worlds

    world_settings = {field: value for field, value in settings.items() if field in WORLD_FIELDS}
    if policy:  # pictures do not show rewards, whose code is not run
        rewards = world_settings.get("reward") or REWARDS[:1]
        world_settings["reward"] = [reward if reward in REWARDS else REWARDS[0] for reward in rewards]
    worlds = Worlds(1, make_env_config({**world_settings, **dict(set_ or ())}, name))
    worlds.seed([seed])
    worlds.reset()
    generator = np.random.default_rng(seed)
    if isinstance(policy, Policy):
        act = action_sampler(policy, worlds, generator)
    elif player == HUNTER:
        act = Hunter(worlds).act
    else:
        act = RandomPlayer(generator).act
    if not is_moving:
        write_file(out, watch.encode_png(Renderer(worlds, "map", env_id=name).frame()))
        return Result({"file": out}, [f"wrote {out}"])
    renderer = Renderer(worlds, "follow", zoom=GIF_FACTOR, env_id=name)
    most_frames = 1 + round(seconds * watch.FRAME_RATE)  # the first shows the start
    write_file(out, watch.encode_gif(islice(watch.episode_frames(worlds, act, renderer), most_frames)))
    return Result({"file": out}, [f"wrote {out}: {_story(worlds)}"])


def _load_player(
    player: str, env_id: str, results: Path, trust: bool
) -> tuple[Policy | LearnedPolicy, dict[str, Any]]:
    """Return the policy and the settings of a trained run, which must be of an environment."""
    from pneuma.api import stored_policy
    from pneuma.store.store import Store
    from pneuma.store.stored_runs import find_trained, trusted_settings

    try:
        run_prefix = player.removeprefix("run:")
        if player.startswith(BEST):
            run_prefix = _best_run(player, env_id, results)
        store, run_id = find_trained(Store(results), run_prefix)
        settings = trusted_settings(store, run_id, trust)
        policy = stored_policy(store, run_id, settings)
    except UserError as error:
        raise UserError(f"--player {player}: ", *error.args) from None
    if settings.get("env") != env_id:
        raise UserError(f"--player {player}: was trained in {settings.get('env')}, not in {env_id}")
    return policy, settings


def _best_run(player: str, env_id: str, results: Path) -> str:
    """Return the best run of best:STUDY in an environment, by the primary outcome.

    Where none of the study's runs is stored here, those count that come with Pneuma.
    """
    from pneuma.analysis.environments import by_environment
    from pneuma.analysis.ranking import ranked_runs
    from pneuma.analysis.runs import configurations_of, find_study, finished_rows, open_study
    from pneuma.store.index import RunIndex
    from pneuma.store.store import Store
    from pneuma.store.stored_runs import shipped_runs
    from pneuma.study.plan import Query

    index, query = RunIndex(Store(results)), Query().named(player.removeprefix(BEST))
    study, _, _ = configurations_of(index, query.study, None)
    worlds_of_env = [world for world in study.worlds if WORLDS[world].env == env_id]
    query = replace(query, world=next(iter(worlds_of_env), None))
    for policies in (index, RunIndex(shipped_runs())):
        data = finished_rows(policies, find_study(policies, query))
        if (data.runs["where"] == "").any():
            break
    else:
        data = open_study(index, query)
    data_by_environment = by_environment(data)
    if env_id not in data_by_environment:
        raise UserError(f"was trained in {' and '.join(data_by_environment)}, not in {env_id}")
    outcome, ranked_frame = ranked_runs(data_by_environment[env_id])
    best = ranked_frame.iloc[0]
    say(f"{player}: {best.condition}, seed {best.seed}, run {best.run_id} ({outcome} {best.value:.3g})")
    return str(best.run_id)


def _story(worlds: Worlds) -> str:
    """Return what happened in an episode."""
    from pneuma.env.watch import SECONDS_AFTER_LAST_KILL, agent_steps

    monster_count, ending = worlds.monsters.shape[1], worlds.ending(0)
    killed = monster_count - worlds.worlds["monsters_left"][0]
    outcome = f"{killed} of {monster_count} monsters killed, {counted(agent_steps(worlds), 'step')}"
    if ending != "running":
        return f"{outcome}, {ending.replace('-', ' ')}"
    if killed < monster_count:
        return f"{outcome}; the episode goes on: --seconds shows more"
    return f"{outcome}; it ends {SECONDS_AFTER_LAST_KILL} s after the last kill, the episode itself goes on"
