"""Arming checks: what keeps a vehicle from arming, in words."""

from __future__ import annotations

from qrsim.links.mavlink.stack.codes import Sensor
from qrsim.links.mavlink.stack.craft import Craft

# A fix has to hold for so long [s].
FIX_FOR = 1.0
_SENSORS = (
    (int(Sensor.GYRO), "gyroscope"),
    (int(Sensor.ACCELEROMETER), "accelerometer"),
    (int(Sensor.MAGNETOMETER), "magnetometer"),
    (int(Sensor.BAROMETER), "barometer"),
)


class ArmingChecks:
    """The checks of one vehicle, with the memory that they need."""

    def __init__(self) -> None:
        self._fix_since: float | None = None

    def look(self, craft: Craft) -> None:
        """Note since when the GNSS receiver has had a 3-D fix; call it at every tick, for ``reasons``."""
        if craft.seen.fix_type < 3:
            self._fix_since = None
        elif self._fix_since is None:
            self._fix_since = craft.seen.time

    def reasons(self, craft: Craft) -> list[str]:
        """Return the reasons why the vehicle cannot be armed (fix, battery and others); [] if it can."""
        seen, values = craft.seen, craft.parameters.values
        if seen.stopped:
            return [seen.end]
        if craft.terminated:
            return ["flight was terminated; reboot"]
        found = []
        if not seen.valid:
            found.append("attitude or position estimate not valid")
        if self._fix_since is None:
            found.append(f"GNSS fix type {seen.fix_type}, 3 needed")
        elif seen.time - self._fix_since < FIX_FOR:
            found.append("GNSS fix too new")
        found += [f"{name} not healthy" for bit, name in _SENSORS if seen.present & bit and not seen.healthy & bit]
        if seen.charge <= values["BAT_CRIT_THR"]:
            found.append(
                f"battery {100.0 * seen.charge:.0f} %, more than {100.0 * values['BAT_CRIT_THR']:.0f} % needed"
            )
        if not seen.on_ground:
            found.append("not on the ground")
        elif seen.valid and not craft.fence.inside(*seen.position_ned):
            found.append("outside the fence")
        return found
