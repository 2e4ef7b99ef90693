"""The runs that claims fixed in advance, found by their ids, and the commands that train them."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from functools import cache

from pneuma.analysis.arms import TRAIN_WITH, ClaimRuns
from pneuma.analysis.claims import Claim, ClaimList
from pneuma.analysis.frames import FinishedRun, StudyData
from pneuma.analysis.run_index import RunIndex
from pneuma.config import as_fields
from pneuma.study.plan import Cell, Selection, make_plan
from pneuma.study.spec import CLAIMS, CLAIMS_FILE, Study, load_study
from pneuma.worlds import world_option


def find_runs(index: RunIndex, claims: ClaimList) -> Iterator[ClaimRuns]:
    """Yield the runs of each claim of a list in each of its worlds, in the list's order."""
    store, read_study = index.store, cache(load_study)

    @cache
    def plan(name: str, world: str, condition: str, seeds: tuple[int, ...], steps: int) -> tuple[Cell, ...]:
        study = read_study(name, world)
        selection = Selection(next(iter(study.presets)), seeds, steps, conditions=(condition,))
        return make_plan(study, selection).cells

    rest = " --unpublished" if store.published(shipped=False) else ""
    for claim in claims.claims.values():
        is_path = claim.study.endswith(".toml")
        path = str(claims.path.parent / claim.study) if is_path else claim.study
        for world in claim.worlds:
            study = read_study(path, world)
            seeds = claim.seeds_in(world)
            cells = {
                condition: plan(path, world, condition, seeds[condition], claim.steps[condition])
                for condition in claim.compared
            }
            ids = [cell.run_id for each in cells.values() for cell in each]
            rows = index.rows(index.entries[run_id] for run_id in ids if run_id in index.entries)
            found = [
                FinishedRun(condition, cell.seed, rows[cell.run_id])
                for condition, each in cells.items()
                for cell in each
                if cell.run_id in rows
            ]
            fields = {condition: as_fields(each[0].run) for condition, each in cells.items()}
            data = StudyData(study.name, study.title, study.figure, "", fields, found) if found else None
            commands = _preset_commands(claims, claim, study) or _commands(claim, path, world, study.worlds)
            mend = f"{TRAIN_WITH} {' && '.join(command + rest for command in commands)}"
            yield ClaimRuns(claim.in_world(world), world, cells, data, mend, index.problems)


def _preset_commands(claims: ClaimList, claim: Claim, study: Study) -> list[str]:
    """Return the commands, one a budget, that train a study's claimed runs; none if the list is elsewhere."""
    if study.path is None or claims.path.resolve() != (study.path.parent / CLAIMS_FILE).resolve():
        return []
    alike = [one for one in claims.claims.values() if one.study == claim.study and study.world in one.worlds]
    several = len({steps for one in alike for steps in one.steps.values()}) > 1
    name = study.own_path or study.name
    words = ["pneuma", "study", "run", name, "--preset", CLAIMS, *world_option(study.world, study.worlds)]
    budgets = sorted({*claim.steps.values()}) if several else [0]
    return [shlex.join([*words, *(["--steps", str(steps)] if steps else [])]) for steps in budgets]


def _commands(claim: Claim, study: str, world: str, worlds: Sequence[str]) -> list[str]:
    """Return the commands that train the runs of a claim in a list that is not beside the study's file."""
    alike: dict[tuple[tuple[int, ...], int], list[str]] = {}
    for name in claim.conditions:
        alike.setdefault((tuple(sorted(claim.seeds[name])), claim.steps[name]), []).append(name)
    commands = []
    for (seeds, steps), names in alike.items():
        every = seeds == tuple(range(seeds[0], seeds[-1] + 1))
        listed = f"{seeds[0]}..{seeds[-1]}" if every else ",".join(map(str, seeds))
        words = ["pneuma", "study", "run", study, *world_option(world, worlds)]
        words += [word for name in names for word in ("--condition", name)]
        commands.append(shlex.join([*words, "--seeds", listed, "--steps", str(steps)]))
    return commands
