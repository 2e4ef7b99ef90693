"""The compiled engine: PPO with Stable-Baselines3's arithmetic, many times as fast.

A rollout is one compiled call (`rollout.py`) and an update two (`learner.py`, `update.py`); Python only
passes arrays from one to the other. Runs of equal shapes use the same programs, which a process compiles
once. Computing several runs at the same time would not be faster on one core, and this way no run can depend
on another.
"""
