"""The command line: each command parses its options, makes one call and prints the result.

Exit codes: 0 done; 1 a run crashed; 2 the command or a file it read was wrong, printed in one line;
130 after Ctrl-C.
"""

from __future__ import annotations

import io
import os
import re
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from pneuma.errors import Message, UserError, printable, shortened, write_hints

STOPPED = 130
"""The exit code after Ctrl-C; it is 1 if runs failed, and 0 if all is done."""
THREAD_SECONDS = 5
"""Seconds that a thread of a user's environment has to end."""
REMOVED = {
    ("env", "play"): "play with gymnasium.utils.play, as docs/environment.md shows",
    ("run", "fork"): "`pneuma study run NAME --set KEY=VALUE` trains other settings from the start",
    ("compare", "--plot"): "`pneuma study plot STUDY --figure summary` draws outcomes",
    ("plot", "--center"): "curves are means; `pneuma study summary` of several environments has others",
    ("figure",): "`pneuma study plot` draws figures",
}
"""Words of earlier versions, and what there is in their place."""
COMMANDS = {
    "study": ("study", "Compare conditions over many seeds."),
    "run": ("runs", "Inspect, export and delete single runs."),
    "search": ("search", "Search hyperparameters and confirm them on fresh seeds."),
    "env": ("env", "List and draw environments."),
    "report": ("report", "Write all evidence as one HTML page."),
    "import": ("logs", "Import logs of other programs as a study."),
}
"""Of each command the module that has it, and what it does."""


BEGINNING = """\
Pneuma repeats and tests the experiments of the PneumaRL thesis, and studies of your own.

  pneuma study run activation                Train a small study: 15 runs, in about a minute.
  pneuma study plot activation               Draw its learning curves.
  pneuma study compare activation tanh relu  Compare two of its conditions, with intervals.

`pneuma --help` lists all commands. Each has --help, with an example."""
"""What `pneuma` alone prints."""


class _Commands(Mapping[str, Any]):
    """The commands by name, each imported when it is needed."""

    def __getitem__(self, command_name: str) -> Any:
        group = get_command(import_module(f"pneuma.cli.{COMMANDS[command_name][0]}").app)
        return getattr(group, "commands", {}).get(command_name, group)

    def __iter__(self) -> Iterator[str]:
        return iter(COMMANDS)

    def __len__(self) -> int:
        return len(COMMANDS)


class _Root(TyperGroup):
    """The group of all commands, whose help imports none."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{**options, "commands": _Commands()})

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find a command; of one that is in a group, such as `plot`, name the group."""
        if args[0] == "run" and "".join(args[1:2]).endswith(".toml"):
            raise UserError(f"`pneuma run` is about single stored runs: `pneuma study run {args[1]}`")
        try:
            return super().resolve_command(ctx, args)
        except typer.TyperException:
            for group in COMMANDS:
                if args[0] in getattr(self.commands[group], "commands", {}):
                    raise UserError(f"no such command {args[0]!r}: `pneuma {group} {args[0]}`") from None
            raise

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(command_name, text) for command_name, (_, text) in COMMANDS.items()])


app = typer.Typer(
    help="Reproduce, compare and judge reinforcement-learning experiments: the PneumaRL thesis's and yours.",
    name="pneuma",
    cls=_Root,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    invoke_without_command=True,
    rich_markup_mode=None,
)


def _print_version(is_requested: bool) -> None:
    if is_requested:
        from pneuma import __version__

        print(f"pneuma {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    context: typer.Context,
    version: bool = typer.Option(
        False, "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
    ),
) -> None:
    """Options before any command; without one, what to begin with."""
    if context.invoked_subcommand is None:
        print(BEGINNING)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit code; a user's mistake is printed as one line."""
    typed_words = None if arguments is None else list(arguments)
    try:
        if not re.fullmatch(r"[1-9]\d{0,8}", threads := os.environ.get("NUMBA_NUM_THREADS", "1")):
            raise UserError(f"the variable NUMBA_NUM_THREADS = {threads} is not allowed: a number from 1 on")
        os.environ["MPLBACKEND"] = "agg"  # figures are files; another value, or a wrong one, is for scripts
        os.environ.pop("SOURCE_DATE_EPOCH", None)  # no figure has a date
        exit_code = app(args=typed_words, prog_name="pneuma", standalone_mode=False)
    except UserError as error:
        from pneuma.cli.hints import write_hint  # not for `--help`

        return _refuse(write_hints(Message(*error.args), write_hint))
    except typer.TyperException as error:
        typed_words = typed_words or sys.argv[1:]
        message = error.format_message()
        return _refuse(message + _with_point(message, typed_words) + _in_its_place(typed_words))
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
    return exit_code if isinstance(exit_code, int) else 0


def _with_point(message: str, typed_words: Sequence[str]) -> str:
    """Return how a number with a comma is written; empty if a message is not of numbers."""
    for word in typed_words:
        parts = re.fullmatch(r"(?:--[\w-]+=)?(\d+),(\d+)", word)
        if parts and "valid number" in message:
            return f". Write {parts[1]}.{parts[2]}"
    return ""


def _in_its_place(typed_words: Sequence[str]) -> str:
    """Return what there is in the place of what an earlier version had; empty if it had no such thing."""
    if list(typed_words[:2]) == ["run", "list"] and typed_words[2:]:
        return " A study's runs: `pneuma run list --study NAME`"
    for removed_words, remaining in REMOVED.items():
        if all(word in typed_words for word in removed_words):
            return f" It was removed: {remaining}"
    return ""


def run() -> None:
    for stream_name in ("stdin", "stdout", "stderr"):  # one that is closed takes and gives nothing
        if getattr(sys, stream_name) is None:
            setattr(sys, stream_name, open(os.devnull, "r" if stream_name == "stdin" else "w"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):  # a terminal of few characters shows the others as \\u…
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    exit_code = main()
    if exit_code == STOPPED:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C, while the interpreter ends
    if threading.active_count() > 1:
        _end_with_threads(exit_code)
    raise SystemExit(exit_code)


def _end_with_threads(exit_code: int) -> None:
    """End the process although threads that a user's environment started are not at their end."""
    for thread in threading.enumerate():
        if not thread.daemon and thread is not threading.main_thread():
            thread.join(THREAD_SECONDS)
            if thread.is_alive():
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(exit_code)


def _refuse(message: str) -> int:
    if message.startswith("Usage:"):  # a command was left out: Typer's message is the help itself
        print(message, file=sys.stderr)
    else:
        message_line = shortened(printable(" ".join(message.split())))
        print(f"pneuma: {message_line}", file=sys.stderr)
    return 2
