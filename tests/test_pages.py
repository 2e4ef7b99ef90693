"""What README, CONTRIBUTING.md and docs name exists, and commands print what the pages show."""

from __future__ import annotations

import doctest
import json
import re
import runpy
import shlex
import tomllib
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest
from typer.main import get_command

from pneuma.algorithms import ALGORITHMS, OPTIMIZERS
from pneuma.analysis.claims.claim_list import load_claims
from pneuma.analysis.outcomes import OUTCOMES
from pneuma.cli import app
from pneuma.cli.study_files import FIGURE_KINDS
from pneuma.config import ACTIVATIONS
from pneuma.errors import UserError
from pneuma.search.samplers import PRUNERS, SAMPLERS
from pneuma.search.spec import load_search
from pneuma.store.quantities import ACTION_QUANTITIES, CURVE_QUANTITIES
from pneuma.study.spec import load_study
from tools.pages import PAGES, ROOT, renewed, rewrite

_COMMAND = re.compile(
    r"(?<=`)pneuma [^`]+(?=`)|(?:(?<=^ {4})|(?<=&& ))pneuma (?:\\\n|[^\n&`])+", re.MULTILINE
)
_PLACEHOLDER = re.compile(r"[….|]|^[A-Z_]+$|^\[|\]$")


def _missing(command_line: str) -> list[str]:
    """Return the words of a command line that the program does not have, and options that it needs."""
    words = shlex.split(command_line.replace("\\\n", " "), comments=True)[1:]
    command: Any = get_command(app)
    while words and hasattr(command, "commands"):
        if words[0].startswith("-") or _PLACEHOLDER.search(words[0]):
            break
        if words[0] not in command.commands:
            return [words[0]]
        command = command.commands[words.pop(0)]
    existing, needed = {"--help", "-h"}, set()
    for parameter in command.params:
        existing.update(parameter.opts, parameter.secondary_opts)
        if parameter.required and parameter.param_type_name == "option":
            needed.add(parameter.opts[0])
    options = {word.partition("=")[0] for word in words if word.startswith("--")}
    return sorted(options - existing) + sorted(needed - options if options else ())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_and_links_of_a_page_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    missing = {command_line: _missing(command_line) for command_line in _COMMAND.findall(text)}
    assert {command_line: words for command_line, words in missing.items() if words} == {}
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", text)
    assert [link for link in links if "://" not in link and not (page.parent / link).exists()] == []


def test_files_that_contributing_names_exist() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    names = {*re.findall(r"`((?:\w+/)*\w+\.(?:py|toml|md))`", text)} - {"analysis/NAME.py", "figures/NAME.py"}
    assert len(names) > 30
    for name in names:
        assert [*ROOT.glob(name), *ROOT.glob(f"pneuma/**/{name}"), *ROOT.glob(f"tests/**/{name}")], name


NAMED = {
    "studies.md": [*OPTIMIZERS, *ACTIVATIONS, *FIGURE_KINDS, *({*CURVE_QUANTITIES} - {*ACTION_QUANTITIES})],
    "engines.md": [name for name, optimizer in OPTIMIZERS.items() if not optimizer.torch_class],
    "search.md": [*SAMPLERS, *PRUNERS],
    "outcomes.md": [name for name in OUTCOMES if not name.startswith("final-action-")],
    "environments.md": [*ALGORITHMS],
}
"""What a page must name, because it can be chosen."""


@pytest.mark.parametrize(("page", "names"), NAMED.items())
def test_pages_name_what_can_be_chosen(page: str, names: list[str]) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    assert [name for name in names if not re.search(rf'[` "]{name}[`",]', text)] == []


def test_pages_show_what_their_commands_print_from_published_tables() -> None:
    """`make figures` updates them."""
    assert [page.name for page in renewed()] == []


def test_a_block_becomes_what_its_command_prints(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    other = "<!-- pneuma study show activation -->\n<!-- end -->\n"
    page.write_text(f"a\n\n<!-- pneuma study list --json -->\nold\n<!-- end -->\n\nb <!-- end -->\n{other}")
    assert rewrite([page]) == [page]
    before, _, rest = page.read_text().partition("<!-- pneuma study list --json -->\n\n")
    printed, _, after = rest.partition("\n<!-- end -->\n")
    assert before == "a\n\n"
    assert after.startswith("\nb <!-- end -->\n<!-- pneuma study show activation -->\n\nActivation function")
    assert "activation" in {study["study"] for study in json.loads(printed)["studies"]}
    assert rewrite([page]) == []
    page.write_text("<!-- docstring pneuma.env.gym.PneumaEnv Starting and ending -->\n<!-- end -->\n")
    rewrite([page])
    assert "\n\nAn episode starts at " in page.read_text() and "##" not in page.read_text()


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ("pneuma study run activation", "pages hold what"),
        ("pneuma study compare activation tanh relu --out there", "pages hold what"),
        ("pneuma study collapse activation --results there", "pages hold what"),
        ("pneuma study show nothing", "nothing"),
        ("docstring pneuma.env.gym.PneumaEnv Weather", "Weather -->: there is no such heading"),
        ("pneuma study list -->\n\nprose\n\n<!-- pneuma study list", "a block has no line <!-- end -->"),
    ],
)
def test_a_block_that_trains_or_fails_is_refused_and_kept(tmp_path: Path, block: str, message: str) -> None:
    page, text = tmp_path / "page.md", f"<!-- {block} -->\n<!-- end -->\n"
    page.write_text(text)
    with pytest.raises(UserError, match=message):
        rewrite([page])
    assert page.read_text() == text


_INDENTED = re.compile(r"(?:^ {4}.*\n|^\n(?= {4}))+", re.MULTILINE)
_FENCED = re.compile(r"^```toml\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_IS_TOML = re.compile(r"title = |\[[\w.-]+\] *(#.*)?$", re.MULTILINE)
_REST_OF_A_STUDY = "\n[conditions.usual]\n[presets.quick]\nseeds = 1\nsteps = 1_000\n"


def _toml_blocks(page: Path) -> list[str]:
    """Return a page's files of TOML, and parts of them, as text."""
    text = page.read_text(encoding="utf-8")
    blocks = [dedent(block).lstrip("\n") for block in _INDENTED.findall(text)] + _FENCED.findall(text)
    return [block for block in blocks if _IS_TOML.match(block)]


def test_files_on_pages_are_allowed(tmp_path: Path) -> None:
    """Of studies, also parts; of searches and claims, whole files."""
    loaded: list[str] = []
    for page in PAGES:
        for block in _toml_blocks(page):
            contents = tomllib.loads(block)
            path = tmp_path / f"{page.stem}-{len(loaded)}.toml"
            if contents.keys() <= {"run", "factors"}:
                block = f'title = "A part"\n{block}{_REST_OF_A_STUDY}'
            path.write_text(block, encoding="utf-8")
            if "claims" in contents:
                load_claims(path)
            elif "space" in contents:
                load_search(str(path))
            elif "presets" in tomllib.loads(block):
                load_study(str(path))
            else:
                continue
            loaded.append(page.stem)
    assert {"README", "claims", "environments", "paper", "python", "search", "studies", "tutorial"} <= {
        *loaded
    }


def test_pages_stay_short() -> None:
    """A front page that is read to its end, and documentation that is read at all.

    The table of all verdicts, which is made, and `NAMED` do not count.
    """
    texts = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
    texts["verdicts.md"] = re.sub("(?ms)^<!-- pneuma.*?^<!-- end -->", "", texts["verdicts.md"])
    readme = texts.pop("README.md")
    assert len(readme.split()) <= 700 and len(readme.splitlines()) <= 110
    named_words = sum(map(len, NAMED.values()))
    assert sum(len(text.split()) for text in texts.values()) - named_words <= 16_000


def test_answers_have_the_numbers_of_the_verdicts() -> None:
    findings, verdicts = ((ROOT / "docs" / name).read_text() for name in ("findings.md", "verdicts.md"))
    answers = " ".join(findings.partition("## Nine questions")[2].partition("## The verdicts")[0].split())
    intervals = re.findall(r"(?:[\d.,]+ against [\d.,]+ % )?\([^()]*; ±[\d.,]+\)", answers)
    assert len(intervals) == 10
    assert [interval for interval in intervals if interval not in verdicts] == []


def test_an_indexs_page_leads_to_the_repository_or_has_no_pictures() -> None:
    index_page = runpy.run_path(str(ROOT / "setup.py"))["index_page"]
    page = "![a picture](a.png)\n\nSee [docs](docs/x.md#y) and [other](https://b.org).\n"
    assert index_page(page, "https://a.org/r/") == (
        "![a picture](https://a.org/r/a.png)\n\n"
        "See [docs](https://a.org/r/docs/x.md#y) and [other](https://b.org).\n"
    )
    assert index_page(page, "") == "See docs and [other](https://b.org).\n"


def test_the_first_lines_of_python_print_what_the_front_page_shows() -> None:
    failed, tried = doctest.testfile(str(ROOT / "README.md"), module_relative=False)
    assert (failed, tried) == (0, 5)


def test_every_picture_and_table_is_shown_by_a_page_and_no_link_to_one_is_broken() -> None:
    folder = ROOT / "paper_figures"
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    text = "".join(page.read_text() for page in PAGES)
    assert {*re.findall(r"\]\((?:\.\./)?paper_figures/([^)#]+)\)", text)} == files
    assert len(files) <= 60 and sum((folder / name).stat().st_size for name in files) <= 8_000_000
