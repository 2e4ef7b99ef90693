"""Seeds as users write them: a count, a list, or text such as 3,5,8 or 1..5."""

from __future__ import annotations

from collections.abc import Collection, Iterable

MOST_SEEDS = 10_000
SEEDS_ALLOWED = f"a count from 1 to {MOST_SEEDS}, a list of different seeds, or text such as 3,5,8 or 1..5"


def read_seeds(seeds: object, first_seed: int = 0) -> tuple[int, ...]:
    """Read seeds: a count n, for the n seeds from the first on; a list; or text with numbers and ranges.

    As text, `"5"` is a count, `"5,"` is the seed 5 alone, and `"1..5"` includes both ends.

    Raises:
        ValueError: for anything else, including repeated seeds.
    """
    if isinstance(seeds, str):
        seeds = _seeds_of_text(seeds)
    if type(seeds) is int and 1 <= seeds <= MOST_SEEDS:
        return tuple(range(first_seed, first_seed + seeds))
    if not isinstance(seeds, list | tuple) or not seeds:
        raise ValueError
    if not all(type(seed) is int and 0 <= seed < 2**32 for seed in seeds):
        raise ValueError
    if len(set(seeds)) < len(seeds):
        raise ValueError
    return tuple(seeds)


def _seeds_of_text(seeds_text: str) -> int | list[int]:
    """Return the count that a text names, or the list of its seeds."""
    if "," not in seeds_text and ".." not in seeds_text:
        return int(seeds_text)
    seeds: list[int] = []
    for range_text in filter(str.strip, seeds_text.split(",")):
        first_text, dots, last_text = range_text.partition("..")
        first_seed = int(first_text)
        last_seed = int(last_text) if dots else first_seed
        if len(seeds) + last_seed - first_seed >= MOST_SEEDS:
            raise ValueError
        seeds.extend(range(first_seed, last_seed + 1))
    return seeds


def format_seeds(seeds: Iterable[int]) -> str:
    """Return seeds as `--seeds` reads them, sorted, neighbours as a range: 0..49,60."""
    ranges: list[list[int]] = []
    for seed in sorted(set(seeds)):
        if ranges and seed == ranges[-1][-1] + 1:
            ranges[-1] = [ranges[-1][0], seed]
        else:
            ranges.append([seed])
    return ",".join("..".join(map(str, range_ends)) for range_ends in ranges)


def seeds_option(seeds: Collection[int]) -> str:
    """Return seeds as the value of an option: as `format_seeds`, but `7,` for the seed 7 alone."""
    seeds_text = format_seeds(seeds)
    return f"{seeds_text}," if len(seeds) == 1 else seeds_text
