"""What tests of several folders share: a results folder, training in this process, a reader of web pages."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

import pytest

from pneuma.store.store import Store
from pneuma.training.executors.local import worker_environment

from .training_here import training_here

# As workers do: on one thread each, since several share the cores, and keeping what JAX compiles for others.
os.environ.update(worker_environment())
if "PYTHONPYCACHEPREFIX" in os.environ:  # as workers, commands that tests start keep byte code
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


@pytest.fixture(scope="session", autouse=True)
def _folders_of_learners(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Stable-Baselines3's own learners leave an empty folder each in the system's: here, in the tests'."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SB3_LOGDIR", str(tmp_path_factory.mktemp("learners")))
        yield


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """An empty results folder."""
    return Store(tmp_path / "results")


@pytest.fixture
def trains_here() -> Iterator[None]:
    """Let commands train in this process; see `training_here.py`."""
    with training_here():
        yield


VOID = {"meta", "img", "br", "link", "hr", "input"}
"""Elements that have no end."""


@dataclass
class Element:
    """An element of a page, with the text of all that is in it."""

    tag: str
    attributes: dict[str, str]
    text: str = ""


class Page(HTMLParser):
    """A page as its elements, in their order; refuses tags that do not nest."""

    def __init__(self, source: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[Element] = []
        self._open: list[Element] = []
        self.feed(source)
        self.close()
        assert self._open == []
        self.anchors = [each.attributes["id"] for each in self.elements if "id" in each.attributes]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        element = Element(tag, {key: value or "" for key, value in attrs})
        assert len(element.attributes) == len(attrs)  # none twice
        self.elements.append(element)
        if tag not in VOID:
            self._open.append(element)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop().tag == tag

    def handle_data(self, data: str) -> None:
        for element in self._open:
            element.text += data

    def all(self, tag: str, css_class: str = "") -> list[Element]:
        """Return the elements of a kind, of a class if one is given."""
        found = [each for each in self.elements if each.tag == tag]
        return [
            each for each in found if not css_class or css_class in each.attributes.get("class", "").split()
        ]


@pytest.fixture
def read_page() -> Callable[[bytes], Page]:
    """A function that takes a page apart."""
    return lambda page: Page(page.decode())
