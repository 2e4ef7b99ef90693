"""Whether tests notice faults: `python -m tests.mutants` (slow), or with a word, those that contain it.

Each table of `mutants.toml` changes a file in one place, as a slip would. It is applied to a copy of the
checkout, where the nearest test files must then fail. One that survives asks for a test by which a user would
notice it. The list has one for each kind of fault, not for each line.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
LIST = Path(__file__).with_name("mutants.toml")
COPIED = (
    "pneuma", "tests", "tools", "studies", "docs", "results/published", "cli.py", "pyproject.toml",
    "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "Makefile",
)  # fmt: skip
LONGEST_SECONDS = 900
FAILED = 1
"""Exit code of pytest where tests failed; others mean that they did not run."""


class Mutant(NamedTuple):
    """A change of one place in a file, and the test files that must notice it."""

    fault: str
    file: str
    old: str
    new: str
    tests: list[str]


def read_mutants(word: str = "") -> list[Mutant]:
    """Return the mutants of the list whose text contains a word.

    Raises:
        SystemExit: when the old text of any is not in its file exactly once.
    """
    mutants = [Mutant(**table) for table in tomllib.loads(LIST.read_text(encoding="utf-8"))["mutant"]]
    problems = []
    for mutant in mutants:
        count = (ROOT / mutant.file).read_text(encoding="utf-8").count(mutant.old)
        if count != 1 or mutant.old == mutant.new:
            problems.append(
                f"{LIST.name}: {mutant.fault}: its old text is {count} times in {mutant.file}, not once; "
                "write old and new as the file is now"
            )
    if problems:
        raise SystemExit("\n".join(problems))
    return [mutant for mutant in mutants if word in " ".join([mutant.fault, mutant.file, *mutant.tests])]


def run_tests(folder: Path, test_files: list[str], seconds: float | None = None) -> int | None:
    """Return pytest's exit code for test files in a copy of the checkout; None if they take too long."""
    words = [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", *test_files]
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    with open(folder / "output.txt", "wb") as output:
        try:
            return subprocess.run(
                words, cwd=folder, env=environment, stdout=output, stderr=output, timeout=seconds
            ).returncode
        except subprocess.TimeoutExpired:
            return None


def is_noticed(folder: Path, mutant: Mutant) -> bool:
    """Apply a mutant to a copy of the checkout, run its tests, and take it back."""
    path = folder / mutant.file
    text, times = path.read_text(encoding="utf-8"), path.stat()
    path.write_text(text.replace(mutant.old, mutant.new), encoding="utf-8")
    try:
        code = run_tests(folder, mutant.tests, LONGEST_SECONDS)
    finally:
        path.write_text(text, encoding="utf-8")
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))  # what is compiled of it stays of use
    if code not in (0, FAILED, None):
        print((folder / "output.txt").read_text(errors="replace")[-2000:])
        raise SystemExit(f"{mutant.fault}: its tests did not run")
    return code != 0


def main() -> int:
    """Report each mutant; return 1 if any survives."""
    mutants = read_mutants(*sys.argv[1:2])
    survivors = []
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name in COPIED:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, folder / name)
            else:
                shutil.copy2(ROOT / name, folder / name)
        test_files = sorted({test_file for mutant in mutants for test_file in mutant.tests})
        if run_tests(folder, test_files) != 0:
            print((folder / "output.txt").read_text(errors="replace")[-4000:])
            raise SystemExit("the tests fail without any mutant")
        for mutant in mutants:
            noticed = is_noticed(folder, mutant)
            print(f"{'noticed' if noticed else 'SURVIVES'}: {mutant.fault} ({mutant.file})", flush=True)
            if not noticed:
                survivors.append(mutant)
    print(f"{len(survivors)} of {len(mutants)} mutants survive")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
