"""Games made with Godot as environments, over Godot RL Agents' protocol.

`game.py` plays such a game, and `wire.py` reads and writes the messages.
"""
