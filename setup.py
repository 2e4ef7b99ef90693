"""The page that a package index shows: the README, with links that lead to the repository."""

import re
import tomllib
from pathlib import Path

from setuptools import setup

FOLDER = Path(__file__).parent


def index_page(text: str, address: str) -> str:
    """Return a page whose links and pictures are under an address; without one it has no pictures."""
    if not address:
        text = re.sub(r"!\[[^]]*\]\([^)]*\)\n*", "", text)
        return re.sub(r"\[([^]]*)\]\((?!\w+:)[^)]*\)", r"\1", text)
    return re.sub(r"\]\((?!\w+:)", f"]({address.rstrip('/')}/", text)


if __name__ == "__main__":
    settings = tomllib.loads((FOLDER / "pyproject.toml").read_text(encoding="utf-8"))
    readme = (FOLDER / "README.md").read_text(encoding="utf-8")
    setup(
        long_description=index_page(readme, settings["tool"]["pneuma"]["address"]),
        long_description_content_type="text/markdown",
    )
