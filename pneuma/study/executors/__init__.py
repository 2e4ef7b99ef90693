"""Executors: where groups of runs are trained. `local` starts processes on this machine."""
