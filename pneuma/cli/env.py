"""`pneuma env …`: list, play and render environments."""

from __future__ import annotations

from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import options as opt
from pneuma.cli.output import Result, check_file, rows_result
from pneuma.errors import UserError, counted, unknown_name

if TYPE_CHECKING:
    from pneuma.engines.policy import Policy
    from pneuma.env.worlds import Worlds

app = opt.Commands("env", "Look at and play environments.")

ABOUT = {
    "pneuma/Pneuma-v0": "the thesis's text, well posed: unit-scale observations, 1,000 steps",
    "pneuma/PneumaGodot-v0": "its published code with the quirks: raw pixels, rewarded events, XP for ever",
    "pneuma/PneumaArena-v0": "the text's rules, rewarded for XP gained less HP lost, the facing observed",
    "pneuma/Mailman-v0": "the three states of the thesis's Fig. 2.1, for tabular methods",
}
"""A description of each environment."""

CAMERAS = ("map", "follow")
PLAYERS = ("random", "hunter")

Environment = Annotated[str, opt.argument("ID", "An environment's id, as in `pneuma env list`.")]
Seed = Annotated[int, opt.option("N", "Seed of the world.", min=0)]


@app.command("list")
def list_() -> Result:
    """List the environments and what they are."""
    import gymnasium

    import pneuma

    rows: list[dict[str, Any]] = []
    for name in pneuma.env.REGISTERED:
        with closing(gymnasium.make(name).unwrapped) as env:
            seen = str(env.observation_space.shape or env.observation_space)
            actions = int(env.action_space.n)  # type: ignore[attr-defined]
        rows.append({"id": name, "observation": seen, "actions": actions, "about": ABOUT[name]})
    return rows_result("environments", rows)


@app.command()
def render(
    name: Environment,
    out: Annotated[Path, opt.option("FILE", "A .png, or a .gif or .mp4 of an episode.")],
    player: Annotated[str, opt.option("random|hunter|RUN_ID", "Who plays the episode.")] = "random",
    camera: Annotated[str | None, opt.choice(CAMERAS, "The whole map, or a player.")] = None,
    seed: Seed = 0,
    seconds: Annotated[float, opt.option("N", "Most seconds of an episode in a video.", min=1.0)] = 20.0,
    set_: opt.Settings = None,
    trust: opt.Trust = False,
    results: opt.Results = opt.HERE,
) -> Result:
    """Draw the world as a picture, or an episode as a video.

    A video shows the first --seconds of an episode, which ends two seconds after the last monster's
    death. A run's policy plays in the environment that it was trained in, --set on top.
    """
    import numpy as np

    from pneuma.engines.policy import drawing
    from pneuma.env import watch
    from pneuma.env.fields import make_env_config
    from pneuma.env.players import Hunter, RandomPlayer
    from pneuma.env.render import FOLLOW_FACTOR, GIF_FACTOR, Renderer
    from pneuma.env.worlds import Worlds

    check_file(out, watch.VIDEOS)
    moving, gif = out.suffix.lower() != ".png", out.suffix.lower() == ".gif"
    if player != "random" and not moving:
        raise UserError(f"--player {player} is for videos, and {out} is a picture: name a .gif or .mp4")
    _check_drawable(name)
    policy, own = (None, {}) if player in PLAYERS else _load_player(player, name, results, trust)
    worlds = Worlds(1, make_env_config({**own, **dict(set_ or ())}, name))
    worlds.seed([seed])
    worlds.reset()
    draws = np.random.default_rng(seed)
    scripted = Hunter(worlds).act if player == "hunter" else RandomPlayer(draws).act
    act = drawing(policy, worlds, draws) if policy else scripted
    # a GIF grows fast: half as many frames, half as wide
    per_step = watch.GIF_FRAMES_PER_STEP if gif else watch.FRAMES_PER_STEP
    zoom, rate = GIF_FACTOR if gif else FOLLOW_FACTOR, watch.frame_rate(per_step)
    renderer = Renderer(worlds, camera or ("follow" if moving else "map"), zoom=zoom)
    most = 1 + round(seconds * rate) if moving else 1  # the first shows the start
    watch.write_video(out, islice(watch.episode_frames(worlds, act, renderer, per_step), most), rate)
    return Result({"file": out}, [f"wrote {out}" + (f": {_story(worlds)}" if moving else "")])


def _load_player(player: str, name: str, results: Path, trust: bool) -> tuple[Policy, dict[str, Any]]:
    """Return a stored run's policy, and its settings.

    A reward is left out if it is code, because pictures do not show it.
    """
    from pneuma.api import load_policy
    from pneuma.env.fields import REWARDS

    try:
        policy, env, settings = load_policy(player, results, trust=trust)
    except UserError as error:
        raise UserError(f"--player {player}: {error}") from None
    if env != name:
        raise UserError(f"--player {player}: was trained in {env}, not in {name}")
    paid = settings.get("reward") or ()
    settings["reward"] = [reward if reward in REWARDS else REWARDS[0] for reward in paid] or REWARDS[:1]
    return policy, settings


def _story(worlds: Worlds) -> str:
    from pneuma.env.watch import SECONDS_AFTER_LAST_KILL, agent_steps

    count, ending = worlds.monsters.shape[1], worlds.ending(0)
    killed = count - worlds.worlds["monsters_left"][0]
    played = f"{killed} of {count} monsters killed, {counted(agent_steps(worlds), 'step')}"
    if ending != "running":
        return f"{played}, {ending.replace('-', ' ')}"
    if killed < count:
        return f"{played}; the episode goes on: --seconds shows more"
    return f"{played}; it ends {SECONDS_AFTER_LAST_KILL} s after the last kill, the episode itself goes on"


@app.command()
def play(
    name: Environment = "pneuma/Pneuma-v0",
    camera: Annotated[str, opt.choice(CAMERAS, "What to see.")] = "follow",
    seed: Seed = 0,
    set_: opt.Settings = None,
) -> Result:
    """Play with the keyboard. The world waits while you hold no key.

    Arrows or W, A, S, D walk, space attacks, with --set magic=true F throws a flame and H heals,
    escape leaves. Needs pygame-ce and a display.
    """
    import gymnasium

    from pneuma.env.watch import FRAMES_PER_STEP, agent_steps, frame_rate, open_display, smooth

    _check_drawable(name)
    open_display()
    from gymnasium.utils.play import play as play_by_keys

    env = gymnasium.make(name, render_mode="rgb_array", camera=camera, **dict(set_ or ())).unwrapped
    worlds = env.state  # type: ignore[attr-defined]
    smooth(worlds)

    def tell_end(*step: Any) -> None:
        *_, terminated, truncated, info = step
        if terminated or truncated:
            killed = counted(info["kills"], "monster")
            print(f"killed {killed} in {counted(agent_steps(worlds), 'step')}")

    rate = round(frame_rate(FRAMES_PER_STEP))
    play_by_keys(env, fps=rate, callback=tell_end, seed=seed, wait_on_player=True)
    return Result({"environment": name})


def _check_drawable(name: str) -> None:
    from pneuma.algorithms import MAILMAN
    from pneuma.config import is_gymnasium_id
    from pneuma.env import REGISTERED

    if is_gymnasium_id(name):
        raise UserError(f"{name} is drawn by Gymnasium: play it with pneuma.load_policy, see docs/python.md")
    if name not in REGISTERED:
        raise unknown_name("environment", name, REGISTERED)
    if name == MAILMAN:
        raise UserError(f"{name} has no picture: it is three states and two actions")
