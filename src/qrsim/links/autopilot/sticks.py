"""From tilt, throttle and yaw rate to the channels of a remote control, as the firmware is configured."""

from __future__ import annotations

import math

# Of a full stick; the firmware counts throttle from MIN_CHECK, and its motors from IDLE of the largest speed.
TILT_RAD, YAW_RATE_RAD_S = math.radians(60.0), math.radians(200.0)
MIN_CHECK, IDLE = 1050, 0.055
CENTRE, HALF, FULL = 1500, 500, 2000


def channels(
    pitch: float, roll: float, throttle: float, yaw_rate: float, throttle_curve: float = 0.0
) -> tuple[int, int, int, int, int, int]:
    """Convert an attitude command [rad, rad/s] to stick channels, 1000 to 2000: roll, pitch, throttle, yaw, arming and
    angle-mode switch.

    Args:
        pitch: nose up [rad]; the stick is pushed to lower the nose.
        roll: right side down [rad].
        throttle: of the vehicle's own commands, 0 to 1; 0 is the lowest stick.
        yaw_rate: clockwise from above [rad/s].
        throttle_curve: a of the vehicle's thrust over throttle, (1 - a) u + a u^2 of the largest.

    What is not finite is a stick in its centre, or the lowest throttle.
    """
    thrust = (1.0 - throttle_curve) * throttle + throttle_curve * throttle * throttle
    lift = 1000
    if thrust > 0.0:
        speed = min(math.sqrt(thrust), 1.0)
        share = max((speed - IDLE) / (1.0 - IDLE), 0.0)
        lift = round(MIN_CHECK + (FULL - MIN_CHECK) * share)
    return (
        _stick_value(roll / TILT_RAD),
        _stick_value(-pitch / TILT_RAD),
        lift,
        _stick_value(yaw_rate / YAW_RATE_RAD_S),
        FULL,
        FULL,
    )


def _stick_value(share: float) -> int:
    """Return the stick channel, 1000 to 2000, for a deflection from -1 to 1; 1500, the centre, for NaN."""
    return CENTRE + round(HALF * max(-1.0, min(1.0, share))) if math.isfinite(share) else CENTRE
