"""A figure's origin: every format gives it back, and whatever a file holds, reading it ends in one line."""

from __future__ import annotations

import json
from pathlib import Path
from zlib import compress, crc32

import pytest
from matplotlib.figure import Figure

from pneuma.cli.options import seeds
from pneuma.figures import FIGURE_FORMATS
from pneuma.figures.origin import Origin, read_origin, sample
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


def test_every_format_holds_command_ids_and_seeds(tmp_path: Path) -> None:
    few, many = ORIGIN.runs
    assert (few.ids, few.seeds, many.seeds) == (("a" * 16, "b" * 16), "1..3", "7,100..149")
    assert many.ids[0].startswith("50 ids, SHA-256 ")
    assert many.condition == AWKWARD.replace("\x1b", "\\u001b").replace("\ud800", "\\ud800")
    png, svg, pdf = _draw(tmp_path)
    assert read_origin(png) == ORIGIN
    for path in (svg, pdf):  # which pneuma does not read
        assert b"pneuma study plot" in path.read_bytes()


def test_other_ids_give_another_origin_in_any_number_and_their_order_does_not() -> None:
    for count in (3, 50):
        names = [f"{k:016x}" for k in range(count)]
        one, turned = sample("s", "c", names, [0]), sample("s", "c", names[::-1], [0])
        assert one == turned != sample("s", "c", ["f" * 16, *names[1:]], [0])


@pytest.mark.parametrize("given", [(5,), (0, 1, 2), (1, 2, 9), (3, 5, 8), (100, 101, 7)])
def test_seeds_are_told_as_the_option_reads_them(given: tuple[int, ...]) -> None:
    told = shown_seeds(given)
    read = seeds("").parser(told if len(given) > 1 else f"{told},")
    assert sorted(read) == sorted(given)


def _png(text: bytes, key: bytes = b"Description") -> bytes:
    """Return a picture of one pixel, or without a key of too many, with a text."""
    size = b"\0\0\0\1\0\0\0\1" if key else b"\0\1\0\0\0\1\0\0"
    chunks = ((b"IHDR", size + b"\x08\0\0\0\0"), (b"tEXt", key + b"\0" + text), (b"IDAT", compress(b"\0\0")))
    parts = [
        len(data).to_bytes(4, "big") + kind + data + crc32(kind + data).to_bytes(4, "big")
        for kind, data in (*chunks, (b"IEND", b""))
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


VALID = Origin(command="c").encode().encode()
UNLIKE = {
    "empty": b"",
    "no such text": _png(VALID, b"Author"),
    "a cut document": _png(VALID[:-1]),
    "no text": _png(b"\xff\xfe"),
    "deep": _png(b"[" * 2**19),
    "other types": _png(b'{"command": 3, "version": "1"}'),
    "numbers for seeds": _png(b'{"command": "", "runs": [{"study":"","condition":"","ids":[],"seeds":1}]}'),
    "a huge picture": _png(VALID, b""),
}


@pytest.mark.parametrize("kind", UNLIKE)
def test_untrusted_a_file_that_tells_no_origin_is_one_line(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "file.png"
    path.write_bytes(UNLIKE[kind])
    code, out, said = call("figure", path)
    assert (code, out, said.count("\n")) == (2, "", 1) and "tells no origin" in said


def test_untrusted_what_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.svg"):
        code, out, said = call("figure", path)
        assert (code, out, said.count("\n")) == (2, "", 1) and "cannot be read" in said


def test_untrusted_what_drives_a_terminal_is_told_as_its_code(tmp_path: Path) -> None:
    path = tmp_path / "file.png"
    path.write_bytes(_png(json.dumps({"command": "\x1b[2J", "version": "\u202e"}).encode()))
    assert r"\u001b[2J" in (said := call("figure", path).out) and r"\u202e" in said
