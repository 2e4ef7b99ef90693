"""A search with its budget: what is searched, and the digest of all that its suggestions depend on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import optuna

from pneuma.config import ENGINE_VERSIONS, RULES_VERSION
from pneuma.search.spec import Budget, Search
from pneuma.study.identity import user_files_digest

FORMAT = 2
"""Of logs; raised when one that was begun before would go on with other suggestions."""
VERSIONS = ("optuna", "rules", "engines", "format")
"""Parts of a search's identity that the user does not choose."""


@dataclass(frozen=True)
class Task:
    """A search with its budget; `over` has fields that replace those of its file."""

    search: Search
    budget: Budget
    over: Mapping[str, Any] = field(default_factory=dict)

    @property
    def identity(self) -> dict[str, Any]:
        """Return everything that the suggestions depend on, except the number of trials."""
        search = self.search
        values = [{key: value} for key, each in search.space.all_values().items() for value in each]
        for name in (search.spec.sampler.name, search.spec.pruner.name):
            if ":" in name and not name.startswith("optuna."):  # Optuna's version is below
                values.append({"wrappers": (name,)})  # which are named, and hashed, alike
        code = [*filter(None, map(user_files_digest, values))]
        return {
            **({"contents": code} if code else {}),
            "base": search.space.base,
            "fixed": search.space.fixed,
            "space": [parameter.identity for parameter in search.space.parameters],
            "objectives": [objective.model_dump() for objective in search.objectives],
            "start": [search.space.named(params) for params in search.first_trials],
            "generation": search.spec.generation,
            "sampler": search.spec.sampler.model_dump(),
            "pruner": search.spec.pruner.model_dump(),
            "seeds": self.budget.seeds,
            "steps": self.budget.steps,
            "optuna": optuna.__version__,
            "rules": RULES_VERSION,
            "engines": ENGINE_VERSIONS,
            "format": FORMAT,
        }

    @property
    def digest(self) -> str:
        text = json.dumps(self.identity, sort_keys=True, default=list)
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    def changes_since(self, identity: Any) -> list[str]:
        """Return where a recorded identity differs from this one, as keys with dots."""
        now = json.loads(json.dumps(self.identity, default=list))
        then, now = (
            {**each, "space": {one["name"]: one for one in each["space"]}} for each in (identity, now)
        )
        return _differences("", then, now)


def _differences(key: str, one: Any, other: Any) -> list[str]:
    if not (isinstance(one, dict) and isinstance(other, dict)):
        return [] if one == other else [key]
    names = {name: f"{key}.{name}" if key else name for name in {**one, **other}}
    return [
        spot for name, place in names.items() for spot in _differences(place, one.get(name), other.get(name))
    ]
