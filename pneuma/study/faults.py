"""Which setting is at fault where only the whole shows that something is wrong.

Each value of a study's file may be allowed by itself, and yet a minibatch exceeds its rollout, or a
class is none of the level's. The setting at fault is the one without which all is well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from importlib import import_module
from typing import Any

from pneuma.config import Run, env_config, make_run
from pneuma.errors import UserError

JUDGED_BY_THE_ENVIRONMENT = ("level", "characters", "classes", "weapons", "perceive", "reward")
"""Settings whose values may name what only files, levels and modules can tell to be there."""

Check = Callable[[Mapping[str, Any]], object]
"""Raises `UserError` for settings that do not go together."""


def fault(settings: Mapping[str, Any], check: Check) -> UserError | None:
    """Return what is wrong with the settings of a run, if anything."""
    try:
        check(settings)
    except UserError as error:
        return error
    return None


def setting_at_fault(settings: Mapping[str, Any], suspects: Iterable[str], check: Check) -> str | None:
    """Return the first of the suspects without which the settings are well, if there is one.

    Those that name things elsewhere come first: they are the likeliest, and environments take time.
    """
    for key in sorted(suspects, key=lambda key: key not in JUDGED_BY_THE_ENVIRONMENT):
        if fault({name: value for name, value in settings.items() if name != key}, check) is None:
            return key
    return None


def check_run(settings: Mapping[str, Any]) -> Run:
    """Resolve settings to a run.

    Raises:
        UserError: when they do not go together.
    """
    return make_run(settings)


def check_environment(settings: Mapping[str, Any]) -> None:
    """Make the environment of a run once; imports the module of a reward of the user's own.

    Raises:
        UserError: when it cannot be made.
    """
    config = replace(env_config(make_run(settings)), random_levels=1)  # their number changes nothing
    import_module("pneuma.env.worlds").Worlds(1, config)
