"""Motors of ArduPilot's frames of the type X, which other firmwares share."""

from __future__ import annotations

# By the number of motors, for each in the order of the firmware's channels: the bearing of its arm, clockwise from the
# nose [deg], and its turn: +1 clockwise from above, -1 the other way. Source: ArduPilot, AP_MotorsMatrix.cpp; with four
# motors Betaflight and PX4 (airframe none_iris) have the same.
FRAMES: dict[int, tuple[tuple[float, int], ...]] = {
    4: ((45.0, -1), (-135.0, -1), (-45.0, 1), (135.0, 1)),
    6: ((90.0, 1), (-90.0, -1), (-30.0, 1), (150.0, -1), (30.0, -1), (-150.0, 1)),
    8: ((22.5, 1), (-157.5, 1), (67.5, -1), (157.5, -1), (-22.5, -1), (-112.5, -1), (-67.5, 1), (112.5, 1)),
}
