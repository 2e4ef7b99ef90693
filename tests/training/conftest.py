"""What all tests of studies share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from .commands import end_commands


@pytest.fixture(autouse=True)
def no_command_is_left() -> Iterator[None]:
    """End what a failed test began."""
    yield
    end_commands()
