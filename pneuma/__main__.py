"""`python -m pneuma …` is the `pneuma` command."""

from pneuma.cli import run

if __name__ == "__main__":
    run()
