"""Studies: from a TOML file to finished runs (spec, plan, execute, executors, store)."""
