"""``qrsim run --every``: which ticks of which stream are logged."""

from __future__ import annotations

from collections.abc import Sequence

from qrsim.errors import UsageError, shortened
from qrsim.runs.layout import LARGEST_EVERY, check_every
from qrsim.runs.streams import STREAMS


def parse_every(words: Sequence[str]) -> dict[str, int]:
    """Parse "STREAM=N" and "N" (for all other streams), in any order, to {stream: N}, the ticks between recorded rows.

    Raises:
        UsageError: a word is of neither form, says the same twice, names no stream, or N is not an integer from 1.
    """
    found: dict[str, int] = {}
    for word in words:
        stream, _, number = word.rpartition("=")
        if not (number.isdecimal() and len(number) < 20 and 1 <= int(number) <= LARGEST_EVERY):
            raise UsageError(
                f"--every {shortened(word, 100)}: expected N or STREAM=N with an integer from 1 to 2**31 - 1"
            )
        if stream in found:
            raise UsageError(f"--every {word}: {stream or 'N for all streams'} is given twice")
        if stream or "=" in word:
            check_every({stream: int(number)}, STREAMS)
        found[stream] = int(number)
    every = found.pop("", 1)
    numbers = {stream: found.get(stream, every) for stream in STREAMS}
    return {stream: number for stream, number in numbers.items() if number > 1}
