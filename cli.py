"""A shim: `python cli.py study run activation` works from a source tree without installing."""

from pneuma.cli import run

if __name__ == "__main__":
    run()
