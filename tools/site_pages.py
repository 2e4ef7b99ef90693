"""A hook of MkDocs: pages of the site that no file in docs/ holds, made when the site is built.

The front page is the README, and the page for contributors CONTRIBUTING.md. The reference of commands comes
from the program itself, that of modules from their docstrings. Pictures that pages show, and tables that they
link to, are taken along.
"""

from __future__ import annotations

import re
from pathlib import Path

import typer.cli
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from typer.main import get_command

from pneuma.cli import app

ROOT = Path(__file__).parents[1]
PICTURES = "paper_figures"
MODULES = {
    "Environments": [
        "pneuma.env.gym", "pneuma.env.gym_vector", "pneuma.env.settings", "pneuma.env.sb3",
        "pneuma.env.pettingzoo",
    ],
    "Studies": ["pneuma.api"],
    "Reading": [
        "pneuma.analysis.study_data", "pneuma.analysis.outcomes", "pneuma.analysis.curves",
        "pneuma.analysis.summaries", "pneuma.analysis.claims.contrasts", "pneuma.analysis.environments",
    ],
    "Figures": ["pneuma.figures.curves", "pneuma.figures.grid", "pneuma.figures.summary"],
    "Policies": ["pneuma.engines.policy"],
}  # fmt: skip
"""The public modules, grouped as a user meets them."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the modules' pages to the contents, under the heading Python."""
    groups = []
    for group, modules in MODULES.items():
        groups.append({group: [{module.removeprefix("pneuma."): _page_name(module)} for module in modules]})
    assert config.nav is not None, "mkdocs.yml has it"
    config.nav.append({"Python": groups})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made, and the pictures."""
    made = {
        "index.md": _page("README.md"),
        "contributing.md": _page("CONTRIBUTING.md"),
        "security.md": _page("SECURITY.md"),
        "commands.md": _commands(),
        **_module_pages(),
    }
    for name, text in made.items():
        files.append(File.generated(config, name, content=text))
    for path in sorted(path for path in (ROOT / PICTURES).rglob("*.*") if path.is_file()):
        files.append(File.generated(config, path.relative_to(ROOT).as_posix(), abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links to pictures, and to the front page, lead into the site, and each picture to its full size."""
    markdown = re.sub(r"(!\[[^]]*\]\(([^)]*)\))", r"[\1](\2)", markdown)
    return markdown.replace(f"](../{PICTURES}/", f"]({PICTURES}/").replace("](../README.md", "](index.md")


def _page(name: str) -> str:
    """Return a page of the repository's root, with links as they are within docs/."""
    text = (ROOT / name).read_text(encoding="utf-8").replace("](docs/", "](")
    return text.replace("](CONTRIBUTING.md", "](contributing.md").replace("](SECURITY.md", "](security.md")


def _commands() -> str:
    command = get_command(app)
    text = typer.cli.get_docs_for_click(
        obj=command, ctx=typer.Context(command, info_name="pneuma"), name="pneuma"
    )
    return re.sub("^# .*", "# Commands", text, count=1)


def _module_pages() -> dict[str, str]:
    """Return a page for each module of `MODULES`, by its name; all that docs/python.md calls are there."""
    calls = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    called = {*re.findall(r"^from (pneuma[\w.]*) import", calls, re.MULTILINE)}
    listed = {module for modules in MODULES.values() for module in modules}
    for module in sorted(called):
        if not any(page == module or page.startswith(f"{module}.") for page in listed):
            raise ValueError(f"MODULES lacks {module}, which docs/python.md calls")
    return {_page_name(module): f"# {module}\n\n::: {module}\n" for module in sorted(listed)}


def _page_name(module: str) -> str:
    return f"python/{module}.md"
