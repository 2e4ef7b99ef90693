"""Engines train runs. `loop` defines the interface, and what all of them do between updates.

`batched` is the default engine, `sb3` the reference.
"""
