"""What tests of training share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from .commands import end_commands


@pytest.fixture(autouse=True)
def no_command_is_left() -> Iterator[None]:
    """End the commands that a failed test left."""
    yield
    end_commands()
