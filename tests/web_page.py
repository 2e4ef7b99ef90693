"""Web pages taken apart."""

from __future__ import annotations

from dataclasses import dataclass
from html.parser import HTMLParser

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

    def __init__(self, source: bytes) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[Element] = []
        self._open: list[Element] = []
        self.feed(source.decode())
        self.close()
        assert self._open == []
        self.anchors = [element.attributes["id"] for element in self.elements if "id" in element.attributes]

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
        """Return the elements with a tag, and with a class if one is given."""
        elements = []
        for element in self.elements:
            classes = element.attributes.get("class", "").split()
            if element.tag == tag and (not css_class or css_class in classes):
                elements.append(element)
        return elements
