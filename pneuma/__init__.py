"""Pneuma: reproduce and judge the experiments of the PneumaRL thesis.

Importing it registers the environments, so that `gymnasium.make("pneuma/Pneuma-v0")` works. The
rest is read where it is needed: `pneuma.env`, `pneuma.engines`, `pneuma.study`, `pneuma.analysis`.
"""

from importlib.metadata import PackageNotFoundError, version

from pneuma.env import register_environments

try:
    __version__ = version("pneuma-rl")
except PackageNotFoundError:  # run from a source tree, by `python cli.py`
    __version__ = "0+source"

register_environments()
