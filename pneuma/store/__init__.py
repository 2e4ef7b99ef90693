"""The store: runs in a results folder and in published tables, their rows, locks and provenance."""

from pneuma.errors import NEEDED_BY_STUDIES, require

require(*NEEDED_BY_STUDIES)
