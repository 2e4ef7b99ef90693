"""Engines: what trains runs. `base` holds the contract, `sb3` the reference engine."""
