"""Who may command which vehicle."""

from __future__ import annotations

from collections.abc import Sequence

from qrsim.errors import UsageError, did_you_mean


class Claims:
    """Exclusive command of vehicles by name.

    Args:
        names: of all vehicles.
        deaf: those of them that take no orders.
    """

    def __init__(self, names: Sequence[str], deaf: Sequence[str] = ()):
        self._names, self._deaf = list(names), set(deaf)
        self._holders: dict[str, int] = {}

    def holder(self, vehicle: str) -> int:
        """Return the number of the client that has claimed a vehicle, 0 for a free vehicle."""
        return self._holders.get(vehicle, 0)

    def of(self, holder: int) -> tuple[str, ...]:
        """Return the names of the vehicles that client number ``holder`` has claimed, in their order in the world."""
        return tuple(name for name in self._names if self._holders.get(name) == holder)

    @property
    def holders(self) -> list[int]:
        """Return the numbers of all clients that have claimed a vehicle, sorted."""
        return sorted(set(self._holders.values()))

    def take(self, holder: int, wanted: Sequence[str]) -> tuple[str, ...]:
        """Claim vehicles for client number ``holder``, all or none (no names: all free ones); return the newly claimed
        names.

        Raises:
            UsageError: no vehicle is called so, takes orders, or is free; another one has it, who is named.
        """
        if not wanted:
            wanted = [name for name in self._names if name not in self._holders and name not in self._deaf]
            if not wanted:
                raise UsageError(f"CLAIM: no vehicle is free: {self._describe_holders()}")
        for name in wanted:
            self._check_claimable(name)
            other = self.holder(name)
            if other not in (0, holder):
                raise UsageError(f"CLAIM: '{name}' is flown by client {other}, which has to release it first")
        found = tuple(dict.fromkeys(name for name in wanted if name not in self._holders))
        self._holders.update(dict.fromkeys(found, holder))
        return found

    def give_back(self, holder: int, names: Sequence[str] = ()) -> tuple[str, ...]:
        """Release vehicles of client number ``holder`` (no names: all of its vehicles), and return their names.

        Raises:
            UsageError: one of them is not his.
        """
        for name in names:
            self.check_own(holder, name, "RELEASE")
        found = tuple(names) or self.of(holder)
        for name in found:
            self._holders.pop(name, None)
        return found

    def check_own(self, holder: int, name: str, what: str) -> None:
        """Raise UsageError, beginning with ``what``, unless client number ``holder`` has claimed the vehicle
        ``name``."""
        other = self.holder(name)
        if other == holder:
            return
        if name not in self._names:
            raise self._unknown_vehicle(name, what)
        if other:
            raise UsageError(f"{what}: '{name}' is flown by client {other}")
        raise UsageError(f"{what}: '{name}' is not claimed; CLAIM it first")

    def _check_claimable(self, name: str) -> None:
        """Raise UsageError unless a vehicle exists and can take orders."""
        if name not in self._names:
            raise self._unknown_vehicle(name, "CLAIM")
        if name in self._deaf:
            raise UsageError(f"CLAIM: '{name}' takes no orders: its scenario sets its motion")

    def _unknown_vehicle(self, name: str, what: str) -> UsageError:
        """Return the error, beginning with ``what``, for a name that no vehicle has."""
        return UsageError(f"{what}: no vehicle is called '{name[:60]}'{did_you_mean(name[:60], self._names)}")

    def _describe_holders(self) -> str:
        """Return a text with up to five claimed vehicles and the clients that have claimed them."""
        held = [f"'{name}' is flown by client {holder}" for name, holder in self._holders.items()]
        shown = "; ".join(held[:5])
        return f"{shown}; and {len(held) - 5} more" if len(held) > 5 else shown or "none of them takes orders"
