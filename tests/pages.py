"""Blocks of code in a page of docs/."""

from __future__ import annotations

import re

BLOCK = re.compile(
    r"(?:^`(?P<file>[\w./]+)`\n)?^```(?P<language>\w+)\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE
)
"""A fenced block: its language and text, and the file that it is, where a line before it names one."""
