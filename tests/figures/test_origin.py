"""A figure's origin: every format gives it back, and whatever a file holds, reading it ends in one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from matplotlib.figure import Figure

from pneuma.analysis.crossed import Map
from pneuma.cli.options import CONTRAST, seeds
from pneuma.figures import FIGURE_FORMATS
from pneuma.figures.maps import contrast_word
from pneuma.figures.origin import LARGEST_DOCUMENT, LARGEST_FIGURE, Origin, read_origin, sample
from pneuma.figures.style import house_style, save_figure
from pneuma.values import shown_seeds

from ..cli.calls import call

AWKWARD = 'a)(\\b"<&amp;>]]>\u00e4\x1b\ud800'
ORIGIN = Origin(
    command='pneuma study plot "a b"',
    runs=(
        sample("mine", "tanh", ["b" * 16, "a" * 16], [3, 1, 2]),
        sample("mine", AWKWARD, [f"{k:016x}" for k in range(50)], [*range(100, 150), 7]),
    ),
)


def _draw(folder: Path, origin: Origin = ORIGIN) -> list[Path]:
    with house_style():
        figure = Figure()
        figure.subplots().plot([0, 1])
        return save_figure(figure, folder, "figure", FIGURE_FORMATS, origin)


def test_every_format_gives_back_command_ids_and_seeds(tmp_path: Path) -> None:
    few, many = ORIGIN.runs
    assert (few.ids, few.seeds, many.seeds) == (("a" * 16, "b" * 16), "1..3", "7,100..149")
    assert many.ids[0].startswith("50 ids, SHA-256 ")
    assert many.condition == AWKWARD.replace("\x1b", "\\u001b").replace("\ud800", "\\ud800")
    for path in _draw(tmp_path):
        assert read_origin(path) == ORIGIN


def test_other_ids_give_another_origin_in_any_number_and_their_order_does_not() -> None:
    for count in (3, 50):
        names = [f"{k:016x}" for k in range(count)]
        one, turned = sample("s", "c", names, [0]), sample("s", "c", names[::-1], [0])
        assert one == turned != sample("s", "c", ["f" * 16, *names[1:]], [0])


def test_the_same_figure_gives_the_same_bytes(tmp_path: Path) -> None:
    for one, again in zip(_draw(tmp_path / "one"), _draw(tmp_path / "again"), strict=True):
        assert one.read_bytes() == again.read_bytes()


@pytest.mark.parametrize("given", [(5,), (0, 1, 2), (1, 2, 9), (3, 5, 8), (100, 101, 7)])
def test_seeds_are_told_as_the_option_reads_them(given: tuple[int, ...]) -> None:
    told = shown_seeds(given)
    read = seeds("--seeds", "").parser(told if len(given) > 1 else f"{told},")
    assert sorted(read) == sorted(given)


@pytest.mark.parametrize("values", [("tanh", "relu"), ([128], [256]), ([0.9, 0.9], [0.9, 0.999]), (0.1, 2)])
def test_a_contrast_is_told_as_the_option_reads_it(values: tuple[Any, Any]) -> None:
    told = contrast_word(Map("field", values, "outcome", (), pd.DataFrame(), ()))
    assert CONTRAST.parser(told) == ("field", *values)


def _png(text: bytes, length: int | None = None) -> bytes:
    size = (len(text) + 12 if length is None else length).to_bytes(4, "big")
    return b"\x89PNG\r\n\x1a\n" + size + b"tEXtDescription\0" + text


def _svg(text: bytes) -> bytes:
    entities = b'<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]>'
    return entities + b"<dc:description>" + text + b"</dc:description>"


VALID = Origin(command="c").encode().encode()
UNLIKE = {
    "empty": b"",
    "nothing in it": b"<svg/>",
    "no document": b"%PDF-1.4 /Subject (a paper)",
    "no end": b"%PDF-1.4 /Subject (" + b"a" * 2**20,
    "many beginnings": b"%PDF-1.4 " + b"/Subject (" * 2**18,
    "a length beyond the file": _png(b"{", 2**32 - 1),
    "a cut document": _png(VALID[:-1]),
    "entities": _svg(b"&b;&b;"),
    "no text": _svg(b"\xff\xfe"),
    "deep": _svg(b"[" * 2**19),
    "no object": _svg(b"[]"),
    "other types": _svg(b'{"command": 3, "version": "1"}'),
    "numbers for seeds": _svg(b'{"command": "", "runs": [{"study":"","condition":"","ids":[],"seeds":1}]}'),
    "too long": _svg(Origin(command="c" * LARGEST_DOCUMENT).encode().encode()),
}


def test_the_smallest_of_each_is_read(tmp_path: Path) -> None:
    """Else the refusals below would show nothing."""
    for data in (_png(VALID), _svg(VALID), b"%PDF-1.4 /Subject (" + VALID + b")"):
        (tmp_path / "file").write_bytes(data)
        assert read_origin(tmp_path / "file").command == "c"


@pytest.mark.parametrize("kind", UNLIKE)
def test_untrusted_a_file_that_tells_no_origin_is_one_line(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "file.png"
    path.write_bytes(UNLIKE[kind])
    code, out, said = call("figure", path)
    assert (code, out, said.count("\n")) == (2, "", 1) and "tells no origin" in said


def test_untrusted_what_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    huge = tmp_path / "huge.png"
    with open(huge, "wb") as file:
        file.truncate(LARGEST_FIGURE + 1)
    for path in (tmp_path, tmp_path / "none.svg", huge, Path("/dev/zero")):
        code, out, said = call("figure", path)
        assert (code, out, said.count("\n")) == (2, "", 1) and "cannot be read" in said


def test_untrusted_what_drives_a_terminal_is_told_as_its_code(tmp_path: Path) -> None:
    path = tmp_path / "file.svg"
    path.write_bytes(_svg(json.dumps({"command": "\x1b[2J", "version": "\u202e"}).encode()))
    assert r"\u001b[2J" in (said := call("figure", path).out) and r"\u202e" in said
