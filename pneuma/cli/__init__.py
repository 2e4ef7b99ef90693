"""The command line: each command parses its options, makes one call and prints the result.

Exit codes: 0 done; 1 a run crashed; 2 the command or a file it read was wrong, said in one line;
130 after Ctrl-C.
"""

from __future__ import annotations

import io
import os
import re
import signal
import sys
from collections.abc import Sequence
from typing import Any

import typer
from typer.core import TyperGroup

from pneuma import __version__
from pneuma.cli import env, misc, runs, search, study
from pneuma.cli.options import Commands
from pneuma.cli.study_run import STOPPED
from pneuma.errors import UserError, plain

COMMANDS = ("study", "run", "search", "env", "report", "figure", "import")
"""In the order of the help; Typer's own puts groups last."""


class _Ordered(TyperGroup):
    def list_commands(self, ctx: Any) -> list[str]:
        return [*COMMANDS]


app = Commands(
    "Reproduce, compare and judge reinforcement-learning experiments: the PneumaRL thesis's, and yours.",
    name="pneuma",
    cls=_Ordered,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)
app.add_typer(study.app, name="study")
app.add_typer(runs.app, name="run")
app.add_typer(search.app, name="search")
app.add_typer(env.app, name="env")
app.command("report", short_help="Write all evidence as one HTML page.")(misc.report)
app.command("figure", short_help="Say which command and runs a figure comes from.")(misc.figure)
app.add_typer(misc.logs, name="import")


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"pneuma {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(
        False, "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
    ),
) -> None:
    """Options before any command."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit code; a user's mistake is printed as one line."""
    try:
        if not re.fullmatch(r"[1-9]\d{0,8}", threads := os.environ.get("NUMBA_NUM_THREADS", "1")):
            raise UserError(f"the variable NUMBA_NUM_THREADS = {threads} is not allowed: a number from 1 on")
        os.environ["MPLBACKEND"] = "agg"  # figures are files; another value, or a wrong one, is for scripts
        os.environ.pop("SOURCE_DATE_EPOCH", None)  # no figure has a date
        words = None if arguments is None else list(arguments)
        code = app(args=words, prog_name="pneuma", standalone_mode=False)
    except UserError as error:
        return _refuse(str(error))
    except typer.TyperException as error:
        return _refuse(error.format_message())
    except (KeyboardInterrupt, typer.Abort):
        print("pneuma: stopped", file=sys.stderr)
        return STOPPED
    except (BrokenPipeError, SystemExit) as ended:  # Typer exits by 1 where a pipe is closed
        if isinstance(ended, SystemExit) and not isinstance(ended.__context__, BrokenPipeError):
            raise
        sys.stderr.close()  # the reader of our output has gone, as in `pneuma … | head`
        return 0
    except RuntimeError as error:  # pathlib's, before Python 3.13
        if not str(error).startswith("Symlink loop"):
            raise
        return _refuse(f"{error}: a link that leads to itself")
    except OSError as error:  # a folder that may not be read, a name too long, a full disk
        return _refuse(f"{error.filename}: {error.strerror}" if error.filename else str(error) or repr(error))
    return code if isinstance(code, int) else 0


def run() -> None:
    for name in ("stdin", "stdout", "stderr"):  # one that is closed takes and gives nothing
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):  # a terminal of few characters shows the others as \\u…
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    code = main()
    if code == STOPPED:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C, while the interpreter ends
    raise SystemExit(code)


def _refuse(message: str) -> int:
    if message.startswith("Usage:"):  # a command was left out: Typer's message is the help itself
        print(message, file=sys.stderr)
    else:
        print(f"pneuma: {plain(' '.join(message.split()))}", file=sys.stderr)
    return 2
