"""Search: hyperparameters found with Optuna, every trial made of ordinary stored runs.

studies/search/NAME.toml → Search → generations of trials → runs → values → the winner, on fresh seeds
"""

FIRST_SEED = 1000
"""Where a search's seeds begin when only their count is given: those of studies, from 0 on, stay fresh."""
