"""Engines train runs. `base` defines the interface, and `loop` what all of them do between updates.

`base` holds the contract, and `loop` what all do between updates; `batched` is the usual engine, `sb3` the
reference, `tabular` has tables.
"""
