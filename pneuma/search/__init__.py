"""Search: hyperparameters found with Optuna, every trial made of ordinary stored runs.

studies/search/NAME.toml → Search → generations of trials → runs → values → the winner, on fresh seeds
"""

FIRST_SEED = 1000
"""The first seed of a search whose seeds are a count; studies use seeds from 0 on."""
