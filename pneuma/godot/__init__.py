"""Both ends of Godot RL Agents' protocol: a game as an environment, and an environment as a game.

`game.py` plays a game that was made with Godot, `serve.py` is the game's side for whatever trains on such
games, and `wire.py` reads and writes their messages.
"""
