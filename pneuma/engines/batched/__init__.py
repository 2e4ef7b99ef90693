"""The compiled engine: PPO with Stable-Baselines3's arithmetic, many times as fast.

A rollout is one compiled call (`rollout.py`) and an update two (`learner.py`, `update.py`); Python only
passes arrays between them. Runs of equal shapes use the same programs, which a process compiles once. Runs
are computed one after another: several at a time would not be faster on one core, and so none can depend on
another.
"""
