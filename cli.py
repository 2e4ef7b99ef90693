"""A shim: `python cli.py study run activation` works from a source tree, with what Pneuma needs installed."""

import sys

try:
    from pneuma.cli import run
except ModuleNotFoundError as missing:
    print(f"pneuma: {missing.name} is not installed: pip install -c constraints.txt .", file=sys.stderr)
    raise SystemExit(2) from None

if __name__ == "__main__":
    run()
