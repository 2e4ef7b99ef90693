"""`pneuma env …`: list and render environments."""

from __future__ import annotations

from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import options as opt
from pneuma.cli.output import Result, check_file, rows_result, write_file
from pneuma.env.fields import ENVIRONMENTS
from pneuma.errors import UserError, counted, unknown_name
from pneuma.presets import WORLDS

if TYPE_CHECKING:
    from pneuma.engines.policy import Policy
    from pneuma.env.worlds import Worlds

app = opt.Commands("env", "List and draw environments.")

ABOUT = {
    "pneuma/Pneuma-v0": "the thesis's text, well posed: unit-scale observations, 1,000 steps",
    "pneuma/PneumaGodot-v0": "its published code with the quirks: raw pixels, rewarded events, XP for ever",
    "pneuma/PneumaArena-v0": "the text's rules, rewarded for XP gained less HP lost, the facing observed",
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
        str, opt.option("AGENT", "Agent: random, hunter, a run id, or best:STUDY (the study's best run).")
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
    from pneuma.config import is_gymnasium_id

    check_file(out, (".gif", ".png"))
    is_moving = out.suffix.lower() == ".gif"
    if player != RANDOM and not is_moving:
        raise UserError(f"--player {player} plays an episode, but {out} is a picture: name a .gif")
    if is_gymnasium_id(name):
        if player == HUNTER or set_:
            raise UserError(f"--player hunter and --set work only in Pneuma's environments, not in {name}")
        return _render_other(name, out, player, seed, seconds, trust, results)
    if name not in ENVIRONMENTS:
        raise unknown_name("environment", name, ENVIRONMENTS)
    import numpy as np

    from pneuma.engines.policy import drawing
    from pneuma.env import watch
    from pneuma.env.fields import make_env_config
    from pneuma.env.players import Hunter, RandomPlayer
    from pneuma.env.render import GIF_FACTOR, Renderer
    from pneuma.env.worlds import Worlds

    policy: Policy | None = None
    settings: dict[str, Any] = {}
    if player not in (RANDOM, HUNTER):
        policy, settings = _load_player(player, name, results, trust)
    worlds = Worlds(1, make_env_config({**settings, **dict(set_ or ())}, name))
    worlds.seed([seed])
    worlds.reset()
    generator = np.random.default_rng(seed)
    if policy is not None:
        act = drawing(policy, worlds, generator)
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


def _render_other(
    env_id: str, out: Path, player: str, seed: int, seconds: float, trust: bool, results: Path
) -> Result:
    """Draw an environment that is not Pneuma's, by its own rendering."""
    from pneuma.api import stored_policy
    from pneuma.config import make_run
    from pneuma.engines.gymnasium_frames import episode_frames, frame_rate
    from pneuma.env import watch
    from pneuma.store.store import Store
    from pneuma.store.stored_runs import find_run, stored_run, trusted_settings

    run, policy = make_run({"env": env_id}), None
    if player != RANDOM:
        store = Store(results)
        run_id = find_run(store, _run_id(player, env_id, results))
        settings = trusted_settings(store, run_id, trust)
        run, policy = stored_run(settings), stored_policy(store, run_id, settings)
        if run.env != env_id:
            raise UserError(f"--player {player}: was trained in {run.env}, not in {env_id}")
    frames = episode_frames(run, policy, seed)
    if out.suffix.lower() == ".png":
        write_file(out, watch.encode_png(next(frames)))
    else:
        rate = frame_rate(run)
        write_file(out, watch.encode_gif(islice(frames, round(seconds * rate)), rate))
    return Result({"file": out}, [f"wrote {out}"])


def _load_player(player: str, env_id: str, results: Path, trust: bool) -> tuple[Policy, dict[str, Any]]:
    """Return a stored run's policy, and its settings.

    A reward is left out if it is code, because pictures do not show it.
    """
    from pneuma.api import load_policy
    from pneuma.engines.policy import Policy
    from pneuma.env.fields import REWARDS

    try:
        policy, trained_in, settings = load_policy(_run_id(player, env_id, results), results, trust=trust)
    except UserError as error:
        raise UserError(f"--player {player}: ", *error.args) from None
    if trained_in != env_id or not isinstance(policy, Policy):
        raise UserError(f"--player {player}: was trained in {trained_in}, not in {env_id}")
    rewards = settings.get("reward") or REWARDS[:1]
    settings["reward"] = [reward if reward in REWARDS else REWARDS[0] for reward in rewards]
    return policy, settings


def _run_id(player: str, env_id: str, results: Path) -> str:
    """Return a player's run; of best:STUDY the best stored one in an environment, by the primary outcome."""
    from pneuma.analysis.environments import by_environment
    from pneuma.analysis.ranking import ranked_runs

    if not player.startswith(BEST):
        return player
    worlds = [name for name, world in WORLDS.items() if world.env == env_id]
    data = opt.RunFilter(world=next(iter(worlds), None), results=results).open(player.removeprefix(BEST))
    data_by_environment = by_environment(data)
    if env_id not in data_by_environment:
        raise UserError(
            f"--player {player}: was trained in {' and '.join(data_by_environment)}, not in {env_id}"
        )
    _, ranked_frame = ranked_runs(data_by_environment[env_id])
    return str(ranked_frame["run_id"].iloc[0])


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
