"""Executors: where groups of runs are trained (`base` says what one is). `local` starts processes here."""
