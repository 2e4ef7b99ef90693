"""Tables as pages, papers and programs take them: `--format`."""

from __future__ import annotations

import contextlib
import csv
import io
import os
import re
import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest

from pneuma.analysis.export import encode_frame
from pneuma.api import open_data
from pneuma.cli.output import Result, Table, print_result, say
from pneuma.store.store import Store

from ..analysis.claim_files import save_runs
from ..hand_made import healthy, learning, save_collapse, study_of
from .calls import call, described, printed, refused

SUMMARY = """\
| condition | runs | final-share-killed | final-return |
| --- | ---: | --- | --- |
| high | 3 | 0.40 ± 0.20 | 0.40 ± 0.20 |
| middle | 3 | 0.200 ± 0.000 | 0.200 ± 0.000 |
"""


@pytest.fixture
def mine(tmp_path: Path) -> list[str]:
    """A study of one's own: of its conditions two have three runs each."""
    save_runs(Store(tmp_path / "results"), tmp_path, {"high": [0.2, 0.4, 0.6], "middle": [0.2] * 3})
    return [str(tmp_path / "mine.toml"), "--world", "text", "--results", str(tmp_path / "results")]


def test_a_summary_as_a_thesis_prints_it(mine: list[str]) -> None:
    """0.2, 0.4 and 0.6 have a mean of 0.4 and a standard deviation of 0.2; the score's return is the same."""
    outcomes = ("--outcome", "final-share-killed", "--outcome", "final-return")
    assert printed("study", "summary", *mine, *outcomes, "--format", "markdown") == SUMMARY
    paper = printed("study", "summary", *mine, *outcomes, "--format", "latex")
    assert r"high & 3 & 0.40 $\pm$ 0.20 & 0.40 $\pm$ 0.20 \\" in paper
    reached = printed("study", "summary", *mine, "--outcome", "steps-to:0.1", "--format", "markdown")
    assert reached.splitlines()[0] == "| condition | runs | steps-to:0.1, median |"
    wide = printed("study", "summary", *mine, *outcomes, "--format", "markdown", "--cells", "interval")
    assert "| high | 3 | 0.400 |" in wide  # of three runs there is no interval
    assert "--cells requires" in refused("study", "summary", *mine, "--cells", "sd")


def test_a_long_latex_table_is_broken_over_pages_and_a_cell_of_markdown_stays_in_its_cell() -> None:
    rows = pd.DataFrame({"condition": [f"c{k}" for k in range(60)], "runs": 3})
    short, long = (encode_frame(rows[:count], "latex").decode() for count in (40, 60))
    assert short.splitlines()[:2] == ["% needs the package booktabs", r"\begin{tabular}{lr}"]
    assert long.splitlines()[:2] == ["% needs the packages booktabs and longtable", r"\begin{longtable}{lr}"]
    assert r"\endhead" in long and "c59 & 3" in long
    signs = encode_frame(pd.DataFrame({"horizon-64": ["-0.04 [-0.1 to 1e-5]"]}), "latex").decode()
    assert "horizon-64 \\\\" in signs and "$-$0.04 [$-$0.1 to 1e-5]" in signs
    twice = pd.DataFrame([["one", "two"]], columns=["same", "same"])
    assert encode_frame(twice, "markdown").decode().splitlines()[-1] == "| one | two |"
    assert "one & two" in encode_frame(twice, "latex").decode()
    odd = encode_frame(pd.DataFrame({"condition": ["a|b", "two\nlines"]}), "markdown")
    assert odd.decode() == "| condition |\n| --- |\n| a\\|b |\n| two<br>lines |\n"


NAMES = {
    # a condition's name: the cell of CSV, the cell of Markdown
    "=1+1": ("'=1+1", "=1+1"),
    "＝1+1": ("'＝1+1", "＝1+1"),
    " @SUM(A1)": ("' @SUM(A1)", " @SUM(A1)"),
    "-2+3": ("'-2+3", "-2+3"),
    "-0.5": ("-0.5", "-0.5"),
    "a; =1": ("a;' =1", "a; =1"),
    "a=1, b=2": ("a=1, b=2", "a=1, b=2"),
    "\x1b]0;owned\x07": ("\\u001b]0;owned\\u0007", "\\u001b]0;owned\\u0007"),
    "\u202egnp": ("\\u202egnp", "\\u202egnp"),
    "<script>x</script>": ("<script>x</script>", "&lt;script>x&lt;/script>"),
    "[x](javascript:x)": ("[x](javascript:x)", r"[x]\(javascript:x)"),
    "![x](//a.b)": ("![x](//a.b)", r"![x]\(//a.b)"),
}


@pytest.mark.parametrize("name", NAMES)
def test_untrusted_names_in_a_table_drive_nothing(name: str) -> None:
    """No spreadsheet, page or terminal runs a name; as a head of a column, too."""
    frame = pd.DataFrame({"condition": [name, "two\nlines"], name: [0.5, -0.25]})
    csv_rows = list(csv.reader(io.StringIO(encode_frame(frame, "csv").decode())))
    assert csv_rows[0] == ["condition", NAMES[name][0]] and csv_rows[1] == [NAMES[name][0], "0.5"]
    assert csv_rows[2] == ["two\nlines", "-0.25"]
    head, _, row, _ = encode_frame(frame, "markdown").decode().splitlines()
    assert (head, row) == (f"| condition | {NAMES[name][1]} |", f"| {NAMES[name][1]} | 0.5 |")
    assert encode_frame(frame, "latex").decode().replace("\n", "").isprintable()


def test_untrusted_an_export_to_the_terminal_drives_nothing(tmp_path: Path) -> None:
    store = Store(tmp_path / "results")
    save_collapse(store, "a0" * 8, healthy(), learning())
    study_of(store, {("\x1b]0;owned\x07\u202e", 0): "a0" * 8})
    words = ("study", "export", "mine", "--table", "summary", "--results", store.root, "--out")
    printed_text = printed(*words, "-")
    assert "\\u001b]0;owned\\u0007\\u202e" in printed_text
    for file_name in ("x.csv", "x.md", "x.tex"):
        printed(*words, tmp_path / file_name)
        assert "owned" in (tmp_path / file_name).read_text()
        for text in (printed_text, (tmp_path / file_name).read_text()):
            assert text.replace("\n", "").isprintable()


def test_a_table_for_people_has_no_control_characters_and_a_dash_for_a_missing_value(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows: list[list[object]] = [["\x1b]0;owned\x07", float("nan")], [None, 0.25]]
    print_result(Result({}, [Table(["\u202ename", "value"], rows)]), "table")
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines == [["\\u202ename", "value"], ["\\u001b]0;owned\\u0007", "–"], ["–", "0.25"]]


def test_a_comparison_in_every_form(mine: list[str]) -> None:
    name, *rest = mine
    words = ["study", "compare", name, "high", "middle", *rest, "--outcome", "final-share-killed"]
    lines = printed(*words, "--format", "markdown").splitlines()
    assert lines[0] == "| outcome | high | middle | difference | P(better) | runs | no value |"
    assert lines[2] == "| final-share-killed | 0.400 | 0.200 | 0.200 | – | 3 and 3 | 0 |"
    (row,) = csv.DictReader(io.StringIO(printed(*words, "--format", "csv")))
    assert (row["a"], row["b"]) == ("high", "middle") and float(row["difference"]) == pytest.approx(0.2)
    assert described(*words, "--json") == described(*words, "--format", "json")
    assert "high against middle" in printed(*words)


def test_the_thesis_tables_are_printed_as_they_stand_there() -> None:
    """Table 6.2 in the thesis's order and words; γ and others are commands of LaTeX."""
    rows = described("study", "table", "--json")["rows"]
    printed_there = "0.99 3e-4 0.95 0.2 2048 64 15 1 0.01"
    assert " ".join(row["Table 6.1"] for row in rows) == printed_there
    latex = printed("study", "table", "table-6-2", "--format", "latex")
    assert latex.isascii() and "\n\\begin{tabular}{lr}\n\\toprule\n" in latex
    assert r"Clipping parameter $\epsilon$ & 0.1 \\" in latex and "Table 6.1" not in latex
    assert "did you mean table-6-2?" in refused("study", "table", "table-62")


TABLES = {
    "thesis": ["table", "table-6-2"],
    "summary": ["summary", "activation"],
    "comparison": ["compare", "activation", "tanh", "relu"],
    "verdicts": ["verify", "betas-solve", "clip-alike"],
}


@pytest.mark.parametrize("name", TABLES)
def test_a_latex_table_has_only_what_pdflatex_knows(name: str, tmp_path: Path) -> None:
    """Dashes and quotation marks are in its usual encodings; minus signs and Greek letters are not."""
    table = printed("study", *TABLES[name], "--format", "latex")
    assert {character for character in table if not character.isascii()} <= set("“”’–…")
    if shutil.which("pdflatex"):  # of texlive-latex-base
        packages = r"\usepackage{booktabs}\usepackage{longtable}"
        page = rf"\documentclass{{article}}{packages}\begin{{document}}\noindent {table}\end{{document}}"
        (tmp_path / "page.tex").write_text(page)
        command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "page.tex"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, errors="replace")
        assert done.returncode == 0, done.stdout


def test_variables_for_other_programs_do_not_stop_a_figure(
    mine: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MPLBACKEND", "nonsense")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "abc")
    printed("study", "plot", *mine, "--format", "pdf", "--out", tmp_path / "drawn")


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_of_a_hundred_columns_shows_words_and_intervals_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A head was once broken as final-share-kil, led."""
    monkeypatch.setenv("COLUMNS", "100")
    heads = [f"final-share-killed-{k} (share)" for k in range(4)]
    cells = ["0.851 [0.827 to 0.876]", "two words that are longer than the rest", "–", "0.5"]
    words = "[0.827 to 0.876]", *(f"final-share-killed-{k}" for k in range(4)), "(share)"
    for columns in (100, 20):  # the latter too narrow for all words, which stay whole
        monkeypatch.setenv("COLUMNS", str(columns))
        with contextlib.redirect_stdout(Terminal()) as terminal:
            print_result(Result({}, [Table(heads, [cells, ["", "b", "c", "d"]])]), "table")
        lines = terminal.getvalue().splitlines()
        assert columns == 20 or max(map(len, lines)) <= 100
        assert all(any(word in line for line in lines) for word in words)
        assert lines[-1].split() == ["b", "c", "d"]


def test_a_path_that_begins_at_home_is_expanded(
    mine: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As no shell does in --results=~/x, nor in the value of a variable."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    words = ("study", "export", "~/mine.toml", "--world", "text", "--table", "summary", "--out", "~/x.csv")
    printed(*words, "--results", "~/results")
    exported = (tmp_path / "x.csv").read_text()
    (tmp_path / "x.csv").unlink()
    monkeypatch.setenv("PNEUMA_RESULTS", "~/results")
    printed(*words)
    assert (tmp_path / "x.csv").read_text() == exported and not Path("~").exists()
    assert open_data("~/mine.toml", world="text").rows


def test_a_style_is_a_regular_file_of_at_most_a_megabyte(mine: list[str], tmp_path: Path) -> None:
    sheet = tmp_path / "own.mplstyle"
    words = ("study", "plot", *mine, "--out", tmp_path / "x.svg", "--style", sheet)
    sheet.write_text("font.size: 9\n")
    printed(*words)
    os.mkfifo(tmp_path / "pipe.mplstyle")
    (tmp_path / "big.mplstyle").write_text("# x\n" * 300_000)
    reasons = {
        "pipe": ": is not a regular file",
        "big": ": is larger than 1 MB, the most that is read",
        "no": ": is neither a matplotlib style sheet nor a file",
    }
    for name, reason in reasons.items():
        path = tmp_path / f"{name}.mplstyle"
        called = call(*words[:-1], path)
        assert (called.code, called.err.splitlines()[-1]) == (2, f"pneuma: --style {path}{reason}")


def test_words_are_folded_at_the_terminals_width(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each line goes on below its first word; nothing is folded elsewhere."""
    monkeypatch.setenv("COLUMNS", "30")
    result = Result({}, ["  indented words of a long line here"], "t", ["a note of some words that is long"])
    with contextlib.redirect_stdout(Terminal()) as terminal:
        print_result(result, "table")
    assert terminal.getvalue().splitlines() == [
        "t", "a note of some words that is", "long", "  indented words of a long", "  line here",
    ]  # fmt: skip
    with contextlib.redirect_stdout(io.StringIO()) as file:
        print_result(result, "table")
    assert len(file.getvalue().splitlines()) == 3
    with contextlib.redirect_stderr(Terminal()) as terminal:
        say("a note of some words that is long")
        say("compare them with `pneuma study compare mine.toml tuned base`")  # a command to copy stays whole
    folded = (
        "a note of some words that is\nlong\ncompare them with\n`pneuma study compare mine.toml tuned base`\n"
    )
    assert terminal.getvalue() == folded


def test_people_read_labels_and_programs_identifiers(tmp_path: Path) -> None:
    results = ["--results", str(tmp_path)]
    compared = ("study", "compare", "optimizer@paper", "non-stationary", "stationary", "--world", "text")
    assert "  betas 0.9, 0.9  betas 0.9, 0.999  " in printed(*compared, *results)
    document = described(*compared, *results, "--json")
    assert "non-stationary" in str(document) and "betas 0.9, 0.9 " not in str(document["comparisons"])
    summary = ("study", "summary", "optimizer@paper", "--world", "text")
    lines = printed(*summary, *results).splitlines()
    assert any(line.startswith("betas 0.9, 0.9  ") for line in lines)
    assert printed(*summary, *results, "--format", "csv").count("\nnon-stationary,") > 1


def test_studies_are_listed_as_the_thesis_has_them() -> None:
    """Its figures, then its sections, then what it lacks."""
    studies = [study["study"] for study in described("study", "list", "--json")["studies"]]
    assert studies[:4] == ["architecture", "actor-size", "optimizer", "activation"]  # Figs. 6.2 to 6.5
    assert studies[4] in ("algorithms", "tuned-algorithms") and studies[-1] == "simplifications"
    later = [studies.index(name) for name in ("magic", "clip-range", "vision")]  # 5.2, 6.3, 7
    assert later == sorted(later)


def test_a_judged_claim_says_each_number_once(tmp_path: Path) -> None:
    text = printed("study", "verify", "tanh-better-own", "--results", str(tmp_path))
    numbers = re.findall(r"return [\d,]+ against \S+ \(.*\)", text)
    assert len(numbers) == 1 and text.count(numbers[0]) == 1
    assert "betas 0.9, 0.9 against ReLU, 30 and 30 runs\n" in text and "non-stationary" not in text
