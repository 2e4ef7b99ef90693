"""Studies: from a TOML file and a query to a plan of runs, and what identifies a run."""
