"""Inner loops of baselines: from tilt, throttle and yaw rate to body rates or rotor speeds."""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.tasks.agents import number_of
from qrsim.tasks.direct import FASTEST_RATES, RATES, hover_throttle, rotor_fractions
from qrsim.tasks.play import Play

# Rate for each radian of tilt, and angular acceleration for each rad/s of roll and pitch rate, and of yaw rate [1/s].
# They are half of those of the vehicles' own stabiliser, because an action is held for 0.02 s.
ANGLE, RATE, YAW_RATE = 4.0, 12.0, 4.0


class Inner:
    """Turns tilt, throttle and yaw rate into the action of a simple task with ``rates`` or ``motors``.

    Args:
        play: the task, with multirotors.

    Attributes:
        hover: throttle, () or (n,), of a hover.
    """

    def __init__(self, play: Play):
        task: Any = play.task
        self._by_rates = task.actions == RATES
        vehicle: Any = play.world.fleets[number_of(play.world, task.fleet)].vehicle
        self._vehicle, self.hover = vehicle, np.asarray(hover_throttle(vehicle))

    def action(self, command: tuple[Floats, ...], seen: Floats) -> tuple[Floats, ...]:
        """Return the numbers (..., n) of an action.

        Args:
            command: pitch and roll [rad], throttle and yaw rate [rad/s], each (..., n); others are not read.
            seen: observations (..., n, 15): estimated state, offset to the goal, body rates.
        """
        pitch, roll, throttle, turn = command[:4]
        wanted = [
            np.clip(rate, -limit, limit)
            for rate, limit in zip(
                (ANGLE * (roll - seen[..., 6]), ANGLE * (pitch - seen[..., 7]), turn),
                FASTEST_RATES.values(),
                strict=True,
            )
        ]
        if self._by_rates:
            return (*wanted, throttle)
        vehicle = self._vehicle
        gains, inertia = (RATE, RATE, YAW_RATE), vehicle.inertia.axes
        torque = [
            np.asarray(size) * gain * (rate - seen[..., 12 + i])
            for i, (size, gain, rate) in enumerate(zip(inertia, gains, wanted, strict=True))
        ]
        thrust = np.asarray(vehicle.thrust_of(np.clip(throttle, 0.0, 1.0))) * vehicle.site_share
        return tuple(rotor_fractions(vehicle, thrust, torque))
