"""The part of the validation about gyroscope and accelerometer."""

from __future__ import annotations

import math

import pytest

from qrsim.studies.validate import imu as part
from qrsim.studies.validate import published


def test_numbers_of_data_sheets() -> None:
    """The ADIS16470 gives both its density and its angle random walk, 0.34 deg/sqrt(h)."""
    found = published.DATA_SHEETS["adis16470"].numbers["gyroscope", "noise"]
    assert found == pytest.approx(math.radians(0.34 / 60.0), rel=3e-3)


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"gyroscope_noise": 6.1707e-5 * 1.2},
        {"accelerometer_noise": 2.7737e-3 * 1.2},
        {"gyroscope_turn_on_bias": 0.34907 * 1.2},
        {"accelerometer_turn_on_bias": 0.78453 * 1.2},
    ],
)
def test_a_chip_with_more_of_an_error_fails(change: dict[str, float]) -> None:
    """20 % more of each number that its data sheet has; as it is, all pass."""
    found = {"mpu6000": part.chips_of("mpu6000", part.FEW_CHIPS, **change)}
    failed = [check.name for check in part._sheet_checks(found) if not check.passed]
    assert len(failed) == len(change), failed
