"""Settings that train in no time, and a study of four such runs, two of them two others by another name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pneuma.study.plan import Plan, Query, make_plan
from pneuma.study.spec import load_study

TINY_RUN = """\
base = "table-6-2"
[run]
horizon = 64
minibatch = 32
epochs = 1
evaluation_episodes = 2
episode_steps = 50
"""
TINY = f"""\
title = "Tiny"
{TINY_RUN}[conditions.one]
[conditions.other]      # the same again: A/A, trained once
[presets.quick]
seeds = 2
steps = 256
"""


def tiny_plan(folder: Path, **selection: Any) -> Plan:
    path = folder / "tiny.toml"
    path.write_text(TINY)
    return make_plan(load_study(str(path)), Query(study=str(path), **selection))
