"""A shim: `python cli.py study run activation` works from a source tree, with what Pneuma needs installed."""

from pneuma.__main__ import run

if __name__ == "__main__":
    run()
