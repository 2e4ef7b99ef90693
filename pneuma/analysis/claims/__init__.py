"""The thesis's sentences as tests, fixed before their runs, and the verdicts on them.

studies/claims.toml → `claim_list` → `fixed_runs` (the runs of each condition) → `contrasts` (effect and
interval) → `verdicts` (the interval decides) → `words` (what pages, pictures, report and command line print)
"""
