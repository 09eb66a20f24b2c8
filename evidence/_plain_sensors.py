"""The noisy sensors of studies that are of controllers: small errors of known size, and none of an estimator."""

from __future__ import annotations

PLAIN = {
    "gnss": {"type": "gnss_receiver"},
    "barometer": {"type": "barometer"},
    "attitude": {"type": "attitude_estimator"},
    "gyroscope": {"type": "gyroscope"},
    "accelerometer": {"type": "accelerometer"},
}
