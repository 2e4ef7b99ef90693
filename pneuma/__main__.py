"""The `pneuma` command, `python -m pneuma`, and what they answer where packages are missing."""

import sys


def run() -> None:
    """Run the command line, or print in one line what has to be installed first."""
    if not (3, 11) <= sys.version_info[:2] < (3, 14):
        version = ".".join(map(str, sys.version_info[:2]))
        raise SystemExit(_refuse(f"Python {version} is not supported: use 3.11, 3.12 or 3.13"))
    try:
        import pneuma.store  # noqa: F401 (says which package is missing)
        from pneuma.cli import run as run_command_line
    except ModuleNotFoundError as missing:
        message = str(missing)
        if sys.platform == "win32" and missing.name == "fcntl":
            message = "Windows has no file locks as runs need them: use Linux, as in WSL"
        raise SystemExit(_refuse(message)) from None
    run_command_line()


def _refuse(message: str) -> int:
    print(f"pneuma: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    run()
