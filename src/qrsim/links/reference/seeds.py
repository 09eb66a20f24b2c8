"""Seeds of successive episodes."""

from __future__ import annotations

MOST_SEEDS = 2**63
EPISODES = ("new", "same")


class Seeds:
    """Seeds of successive episodes: consecutive from a first one, or constant.

    Args:
        first: 0 <= first < 2**63.
        episodes: "new" or "same".
    """

    def __init__(self, first: int, episodes: str = "new"):
        self.episodes = episodes
        self._next = first

    def next(self) -> int:
        """Return the seed of the next episode of this series."""
        found = self._next
        if self.episodes == "new":
            self._next = (found + 1) % MOST_SEEDS
        return found

    def begin(self, first: int) -> Seeds:
        """Return a series of seeds that starts with the seed ``first`` and continues as this one does."""
        return Seeds(first, self.episodes)
