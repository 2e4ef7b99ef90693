"""What is kept while there is room: the first things stay, of the others only the last."""

from __future__ import annotations

from collections import Counter

from pneuma.analysis.kept import LAST_KEPT, Kept


def test_the_first_things_stay_and_of_the_others_the_last_few() -> None:
    made: Counter[int] = Counter()

    def get(key: int) -> bytes:
        def make() -> bytes:
            made[key] += 1
            return bytes(10)

        return kept.get(key, make, len)

    kept: Kept[bytes] = Kept(25)
    for key in range(10):
        assert len(get(key)) == 10
    for key in (0, 1, *range(10 - LAST_KEPT, 10)):
        get(key)
    assert set(made.values()) == {1}
    get(2)
    assert made[2] == 2
