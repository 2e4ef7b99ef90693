"""`pneuma study trajectories`: where the final policies of a study go, and how their episodes end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pneuma.cli.figure_files import Formats, read_figures_asked
from pneuma.cli.options import (
    Json,
    Quiet,
    Results,
    Selected,
    StudyName,
    Trust,
    WorldName,
    print_json,
    read_path,
    say,
    selects,
)
from pneuma.cli.plain_text import plain, print_table
from pneuma.cli.study_output import open_data, tell_written
from pneuma.cli.study_summary import records
from pneuma.env_fields import is_own_level, is_random_level
from pneuma.errors import UserError
from pneuma.study.identity import REWARD, own_things
from pneuma.study.store import Store

if TYPE_CHECKING:
    import pandas as pd

    from pneuma.analysis.tables import FinishedRun, StudyData
    from pneuma.analysis.trajectories import StudyTrajectories

RESULTS = Path("results")
EPISODES = 50


@selects
def trajectories(
    name: StudyName,
    episodes: Annotated[
        int,
        typer.Option(
            "--episodes",
            metavar="N",
            min=1,
            max=1000,
            help="Episodes of each run; published ones stay as many.",
        ),
    ] = EPISODES,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", parser=read_path, help="Draw them on the map, into this folder."
        ),
    ] = None,
    publish: Annotated[
        bool,
        typer.Option(
            "--publish",
            help="Keep them in a small table, beside other runs' there, from which `make figures` draws.",
        ),
    ] = False,
    format: Formats = None,
    trust: Trust = False,
    selection: Selected = None,
    world: WorldName = None,
    results: Results = RESULTS,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Let every run's final policy play, and say where that leads: killed, drowned, cleared, out of time."""
    formats = read_figures_asked(out, format)
    store = Store(results)
    data = open_data(store, name, selection, world, mixed=False)
    from pneuma.analysis.trajectories import (
        beside,
        encode_trajectories,
        endings,
        read_trajectories,
        trajectories_path,
    )

    found = _published(data, results) or _play(store, data, episodes, trust, quiet)
    files = _drawn(data, found, out, formats) if out is not None else []
    if publish:
        path, before = trajectories_path(results, data.study), read_trajectories(results, data.study)
        store.write(path, encode_trajectories(beside(found, before) if before else found))
        files.append(path)
    table = endings(found)
    if json:
        document = {"schema": 1, "study": data.study, "source": data.what, "steps": data.budget}
        told = {"episodes": found.per_run, "endings": records(table), "files": list(map(str, files))}
        return print_json({**document, **told})
    print(f"{plain(data.title)}: {found.per_run} episodes of each run, trained for {data.budget:,} steps")
    _print(table)
    if not files:
        say("Draw them on the map with --out DIR.", aside=True, quiet=quiet)
    return tell_written(files)


def _published(data: StudyData, results: Path) -> StudyTrajectories | None:
    """Return the published trajectories of a study whose runs are not here themselves; None where they are.

    Raises:
        UserError: where neither are.
    """
    from pneuma.analysis.trajectories import read_trajectories

    if len(data.published) < len(data.runs):
        return None
    found = read_trajectories(results, data.study)
    own = found and found.of_runs(data.runs)
    if own is None or not len(own.episodes):
        other = "those of other runs are published; pick them, or " if found else ""
        raise UserError(f"study {data.study}: its policies are not in {results}; {other}{data.how_to_train}")
    runs = own.episodes["run_id"].nunique()
    if runs < len(data.runs):
        say(f"Note: trajectories are published of {runs} of these {len(data.runs)} runs.", aside=True)
    return own


def _play(store: Store, data: StudyData, episodes: int, trust: bool, quiet: bool) -> StudyTrajectories:
    """Let every run's policy play.

    Raises:
        UserError: where no run left a policy, or one would read files of its owner's without trust. A reward
            of its own is not needed.
    """
    from pneuma.analysis.trajectories import gathered

    runs = [run for run in data.runs if run.status != "diverged"]
    if not runs:
        raise UserError(f"study {data.study}: every run diverged, and left no policy")
    if len(runs) < len(data.runs):
        gone = len(data.runs) - len(runs)
        say(f"Note: {gone} of {len(data.runs)} runs diverged, and left no policy to play.", aside=True)
    for run in runs:
        own = own_things({key: value for key, value in data.settings(run).items() if key != REWARD})
        if own and not trust:
            told = plain(" and ".join(own.values()))
            raise UserError(f"run {run.run_id}: would {told}; if you trust where it is from, give --trust")
    return gathered(_level(data), _played(store, data, runs, episodes, quiet))


def _level(data: StudyData) -> str:
    """Return the level that all runs play on; '' where these are several, or drawn at random."""
    levels = {str(data.settings(run).get("level")) for run in data.runs}
    return levels.pop() if len(levels) == 1 and not is_random_level(min(levels)) else ""


def _played(
    store: Store, data: StudyData, runs: Sequence[FinishedRun], episodes: int, quiet: bool
) -> Iterator[dict[str, Any]]:
    """Yield a row for each player in each episode, run by run.

    Raises:
        UserError: for a run that left no policy, or one of a world without places.
    """
    from pneuma.config import ENVIRONMENTS, make_run
    from pneuma.engines.policy import POLICY_FILE, read_sound_policy
    from pneuma.engines.trajectories import play_trajectories

    for number, run in enumerate(runs, 1):
        settings = data.settings(run)
        if settings.get("env") not in ENVIRONMENTS:
            raise UserError(f"study {data.study}: {settings.get('env')} has no places to go to")
        if POLICY_FILE not in store.file_names(run.run_id):
            raise UserError(f"run {run.run_id} of study {data.study} left no policy in {store.root}")
        policy = read_sound_policy(store.read_file(run.run_id, POLICY_FILE))
        try:
            found = play_trajectories(make_run(settings), policy, episodes)
        except UserError as error:
            raise UserError(f"the policy of run {run.run_id} {error}") from None
        for episode, ending in enumerate(found.endings):
            walk = found.places[: found.steps[episode] + 1, episode]  # (steps + 1, players, 2)
            for player in range(walk.shape[1]):
                yield {
                    "condition": run.condition,
                    "seed": run.seed,
                    "run_id": run.run_id,
                    "episode": episode,
                    "player": player,
                    "steps": found.steps[episode],
                    "kills": found.kills[episode],
                    "ending": ending,
                    "places": walk[:, player],
                }
        if not quiet and number % 10 == 0:
            say(f"{number} of {len(runs)} runs have played", aside=True)


def _drawn(data: StudyData, found: StudyTrajectories, out: Path, formats: tuple[str, ...]) -> list[Path]:
    """Draw them on the map; on that of a level of their own where runs have just played, trusted."""
    from pneuma.config import make_run
    from pneuma.engines.trajectories import unrewarded_worlds
    from pneuma.env.render import Renderer
    from pneuma.figures.panels import stem_of
    from pneuma.figures.trajectories import draw_trajectories

    drawer = None
    if is_own_level(found.level) and not data.published:
        worlds = unrewarded_worlds(make_run(data.settings(data.runs[0])), 1)
        worlds.seed([0])
        worlds.reset()
        drawer = Renderer(worlds, "map", panel=False)
    return draw_trajectories(data, found, out, stem_of(data, "trajectories"), formats, drawer)


def _print(table: pd.DataFrame) -> None:
    """Print each condition's shares of endings, then steps and kills; endings that none has are left out."""
    from pneuma.analysis.rounding import shown_with_interval

    heads = list(dict.fromkeys(table["outcome"][table["value"] > 0]))
    rows = []
    for condition, own in table.groupby("condition", sort=False):
        cells = [
            shown_with_interval(row["value"], row["low"], row["high"])
            for row in own.to_dict("records")
            if row["outcome"] in heads
        ]
        rows.append((condition, own["runs"].iloc[0], *cells))
    print_table(("condition", "runs", *(name for name in own["outcome"] if name in heads)), rows)
