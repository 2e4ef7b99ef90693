"""Engines: what trains runs.

`base` holds the contract, and `loop` what all do between updates; `batched` is the usual engine, `sb3` the
reference, `tabular` has tables.
"""
