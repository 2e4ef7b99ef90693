"""Executors: where groups of runs train. `base` defines the interface; `local` starts processes here."""
