"""A shim: `python cli.py study run activation` works from a source tree, with what Pneuma needs installed."""

import sys

try:
    from pneuma.cli import run
except ModuleNotFoundError as missing:
    mend = f"{missing.name} is not installed: pip install -c constraints.txt -e ."
    if sys.platform == "win32":
        mend = "Windows has no file locks as runs need them: use Linux, as in WSL"
    print(f"pneuma: {mend}", file=sys.stderr)
    raise SystemExit(2) from None

if __name__ == "__main__":
    run()
