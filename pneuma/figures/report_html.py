"""The pieces that the report's page is put together from: texts, links, tables, pictures.

`Html` is text that is safe to put into a page; it is made here alone, and the type checker holds
every piece to it. All else, which a stranger's results folder may have named, goes through `text`.
"""

from __future__ import annotations

import hashlib
import html
import re
from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NewType

Html = NewType("Html", str)

MEDIA_TYPES = {"svg": "image/svg+xml", "png": "image/png"}


@dataclass(frozen=True)
class Picture:
    """A figure as it goes into the page.

    Attributes:
        data: the file.
        form: of `MEDIA_TYPES`.
        alt: what it shows, for those who cannot see it.
        caption: what is written below it.
    """

    data: bytes
    form: str
    alt: str
    caption: str


@dataclass(frozen=True)
class Column:
    """A column of a table: its heading, and whether it holds numbers."""

    heading: Html
    numbers: bool = False


def text(value: object) -> Html:
    """Return a value as text that is safe in a page, within quotes too.

    Controls, marks that turn the direction of writing and characters without a width are written as
    their codes: two names that look the same must not be two.
    """
    shown = "".join(c if c.isprintable() or c == "\n" else _code(c) for c in str(value))
    return Html(html.escape(shown, quote=True))


def name(value: object) -> Html:
    """Return a name that may be written in any direction without turning what stands beside it."""
    return Html(f"<bdi>{text(value)}</bdi>")


def code(value: object) -> Html:
    """Return what is typed or printed, such as a command."""
    return Html(f"<code>{text(value)}</code>")


def join(parts: Iterable[Html], by: str = "") -> Html:
    """Put pieces one after the other; `by` is text."""
    return Html(text(by).join(parts))


def element(tag: str, inner: Html, of_class: str = "", anchor: str = "") -> Html:
    """Return an element with what is in it."""
    attributes = f' class="{of_class}"' if of_class else ""
    attributes += f' id="{text(anchor)}"' if anchor else ""
    return Html(f"<{tag}{attributes}>{inner}</{tag}>")


def paragraph(inner: Html, of_class: str = "") -> Html:
    """Return a paragraph."""
    return element("p", inner, of_class)


def anchor_name(kind: str, of: str) -> str:
    """Return the name of a place in the page: the same for the same thing, another for any other."""
    plain = re.sub(r"[^a-z0-9.]+", "-", of.lower()).strip("-")
    if plain == of:
        return f"{kind}-{plain}"
    digest = hashlib.sha256(of.encode(errors="surrogatepass")).hexdigest()[:8]
    return f"{kind}-{plain[:40]}-{digest}"


def link(anchor: str, label: Html) -> Html:
    """Return a link to a place in the page."""
    return Html(f'<a href="#{text(anchor)}">{label}</a>')


def table(
    caption: Html, columns: Sequence[Column], rows: Iterable[Sequence[Html]], anchors: Sequence[str] = ()
) -> Html:
    """Return a table in a box of its own, which scrolls where it is wider than the page.

    Args:
        caption: what it shows.
        columns: as many as a row has cells; the first names the row.
        rows: their cells.
        anchors: names of the rows' places, if they have any.
    """
    head = join(Html(f'<th scope="col"{_aligned(column)}>{column.heading}</th>') for column in columns)
    body = []
    for place, row in enumerate(rows):
        at = f' id="{text(anchors[place])}"' if anchors and anchors[place] else ""
        cells = [Html(f'<th scope="row"{_aligned(columns[0])}>{row[0]}</th>')]
        cells += [
            Html(f"<td{_aligned(column)}>{cell}</td>")
            for column, cell in zip(columns[1:], row[1:], strict=True)
        ]
        body.append(f"<tr{at}>{join(cells)}</tr>")
    return Html(
        f'<div class="scroll" role="region" tabindex="0" aria-label="{text(_words(caption))}">'
        f"<table><caption>{caption}</caption>\n<thead><tr>{head}</tr></thead>\n<tbody>\n"
        + "\n".join(body)
        + "\n</tbody></table></div>\n"
    )


def details(summary: Html, inner: Html) -> Html:
    """Return what is unfolded by a click, and works without a script."""
    return Html(f"<details><summary>{summary}</summary>\n{inner}</details>\n")


def terms(pairs: Iterable[tuple[Html, Html]]) -> Html:
    """Return a list of terms with what each is."""
    return Html("<dl>" + "".join(f"<dt>{term}</dt><dd>{said}</dd>" for term, said in pairs) + "</dl>\n")


def items(inner: Iterable[Html], of_class: str = "") -> Html:
    """Return a list."""
    return element("ul", join(element("li", each) for each in inner), of_class)


def figure(picture: Picture) -> Html:
    """Return a picture with its caption, held in the page itself.

    An SVG is shown as an image: what it names cannot clash with another's, and nothing in it runs.
    """
    source = f"data:{MEDIA_TYPES[picture.form]};base64,{b64encode(picture.data).decode('ascii')}"
    return Html(
        '<figure><div class="scroll" role="region" tabindex="0" aria-label="Figure">'
        f'<img src="{source}" alt="{text(picture.alt)}"></div>'
        f"<figcaption>{text(picture.caption)}</figcaption></figure>\n"
    )


def _aligned(column: Column) -> str:
    return ' class="number"' if column.numbers else ""


def _code(character: str) -> str:
    return f"\\u{ord(character):04x}"


def _words(inner: Html) -> str:
    """Return a piece's words alone."""
    return html.unescape(re.sub(r"<[^>]*>", "", inner))
