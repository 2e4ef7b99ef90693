"""`pneuma env …`: list, check, play and render environments."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from pneuma.cli.options import Json, Results, Settings, print_json, read_settings_options
from pneuma.errors import UserError, unknown_name

app = typer.Typer(help="Look at, check and play environments.", no_args_is_help=True, rich_markup_mode=None)

RESULTS = Path("results")
PLAYERS = ("random", "hunter")

EnvName = Annotated[str, typer.Argument(metavar="ID", help="An environment's id, as in `pneuma env list`.")]
Seed = Annotated[int, typer.Option("--seed", metavar="N", help="Seed of the world.")]


@app.command("list")
def list_(json: Json = False) -> None:
    """List the environments and what they are."""
    import gymnasium

    import pneuma

    rows = []
    for name in pneuma.env.REGISTERED:
        env = gymnasium.make(name).unwrapped
        about = (type(env).__doc__ or "").partition("\n")[0]
        rows.append(
            {
                "id": name,
                "about": about,
                "observation": str(env.observation_space.shape or env.observation_space),
                "actions": int(env.action_space.n),  # type: ignore[attr-defined]
            }
        )
    if json:
        return print_json({"schema": 1, "environments": rows})
    for row in rows:
        print(
            f"{row['id']:<26} observation {row['observation']:<12} {row['actions']} actions  {row['about']}"
        )
    return None


@app.command()
def check(
    name: Annotated[str | None, typer.Argument(metavar="[ID]", help="The environment to check.")] = None,
    all_: Annotated[bool, typer.Option("--all", help="Check every environment.")] = False,
    set_: Settings = None,
    json: Json = False,
) -> int:
    """Check that an environment, with any level, characters or reward of yours, keeps its promises."""
    from pneuma.config import ENVIRONMENTS
    from pneuma.env import REGISTERED
    from pneuma.env.check import check_environment

    names = REGISTERED if all_ or name is None and not set_ else (name or ENVIRONMENTS[0],)
    for each in names:
        if each not in REGISTERED:
            raise unknown_name("environment", each, REGISTERED)
    settings = read_settings_options(set_)
    failed, rows = 0, []
    for each in names:
        for verdict in check_environment(each, settings):
            failed += bool(verdict.problem)
            rows.append({"env": each, "check": verdict.check, "problem": verdict.problem})
            if not json:
                print(f"{each:<26} {verdict.check:<22} {verdict.problem or 'ok'}")
    if json:
        print_json({"schema": 1, "checks": rows})
    return 1 if failed else 0


@app.command()
def render(
    name: EnvName,
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="A .png, or .gif or .mp4 of an episode.")
    ],
    episode: Annotated[bool, typer.Option("--episode", help="Play a whole episode.")] = False,
    player: Annotated[
        str, typer.Option("--player", metavar="random|hunter|RUN_ID", help="Who plays it.")
    ] = "random",
    camera: Annotated[
        str | None, typer.Option("--camera", metavar="map|follow", help="The whole map, or one player.")
    ] = None,
    seed: Seed = 0,
    set_: Settings = None,
    results: Results = RESULTS,
) -> None:
    """Draw the world as a picture, or an episode as a video."""
    from pneuma.env.render import Renderer
    from pneuma.env.show import FRAMES_PER_SECOND, episode_frames
    from pneuma.env.video import check_video, write_video

    check_video(out, FRAMES_PER_SECOND)
    worlds = _worlds(name, set_, seed)
    act = _player(player, worlds, seed, results)
    renderer = Renderer(worlds, camera or ("follow" if episode else "map"))
    frames = episode_frames(worlds, act, renderer) if episode else iter([renderer.frame(0)])
    write_video(out, frames, FRAMES_PER_SECOND)
    print(f"wrote {out}")


@app.command()
def play(
    name: EnvName = "pneuma/Pneuma-v0",
    camera: Annotated[str, typer.Option("--camera", metavar="map|follow", help="What to see.")] = "follow",
    seed: Seed = 0,
    set_: Settings = None,
) -> None:
    """Play with the keyboard: arrows or WASD walk, space attacks, escape leaves."""
    from pneuma.env.show import play as play_world

    for kills, steps in play_world(_worlds(name, set_, seed), name, camera):
        print(f"killed {kills} monsters in {steps} steps")


def _worlds(name: str, settings: list[str] | None, seed: int) -> Any:
    from pneuma.config import ENVIRONMENTS, make_env_config
    from pneuma.env.worlds import Worlds

    if name not in ENVIRONMENTS:
        raise unknown_name("environment", name, ENVIRONMENTS)
    worlds = Worlds(1, make_env_config(read_settings_options(settings), name))
    worlds.seed([seed])
    worlds.reset()
    return worlds


def _player(name: str, worlds: Any, seed: int, results: Path) -> Any:
    """Return what chooses actions: a scripted player, or the policy of a stored run."""
    import numpy as np

    from pneuma.env.players import Hunter, RandomPlayer

    if name == "random":
        return RandomPlayer(np.random.default_rng(seed)).act
    if name == "hunter":
        return Hunter(worlds).act
    from pneuma.engines.policy import read_policy
    from pneuma.study.store import Store

    store = Store(results)
    if not store.status(name).finished:
        raise UserError(f"--player {name}: neither {' nor '.join(PLAYERS)} nor a finished run in {results}")
    policy = read_policy(store.read_file(name, "policy.safetensors"))
    generator = np.random.default_rng(seed)

    def act(shown: Any) -> Any:
        flat = shown.observations.reshape(-1, shown.observations.shape[2])
        if flat.shape[1] != len(policy.actor[0][0]):
            raise UserError(
                f"--player {name}: was trained on {len(policy.actor[0][0])} features, not {flat.shape[1]}"
            )
        return policy.sample(flat, generator).reshape(shown.players.shape)

    return act
