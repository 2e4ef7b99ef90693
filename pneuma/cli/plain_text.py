"""Texts of a stranger's, made safe to print."""

from __future__ import annotations


def plain(text: str) -> str:
    """Return a text without control characters, which could drive a terminal."""
    return "".join(c if c.isprintable() else "?" for c in text)
