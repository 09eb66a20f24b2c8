"""The small form of the study of the radio (``make evidence radio``)."""

from __future__ import annotations

import pytest
from evidence import radio as study


def test_closed_forms_by_hand() -> None:
    """Where half of the packets of wifi are lost, and where a tenth of those of LoRa are, by a pocket calculator."""
    where = study.distances("wifi_2g4")
    # 20 dBm - 40.18 dB - 22 lg d - (-93.99 dBm) = 10.89 dB.
    assert where[3] == pytest.approx(10.0 ** ((20.0 - 40.18 + 93.99 - 10.89) / 22.0), rel=2e-3)
    assert study.distances("lora_sf7")[1] == pytest.approx(10.0 ** ((14.0 - 31.22 + 116.89 + 7.5) / 22.0), rel=5e-3)


def test_reach_along_the_ground_by_hand() -> None:
    """Power 40 lg d - 20 lg(h1 h2) below that sent, of ends 10 m up: half of LoRa's packets at SNR -8.6 dB."""
    far = 10.0 ** ((14.0 + 40.0 + 116.89 + 8.6) / 40.0)
    power = study.received("lora_sf7", far, (10.0, 10.0))
    assert study.lost_at("lora_sf7", power) == pytest.approx(0.5, abs=0.02)


def test_power_over_land_by_hand() -> None:
    """120 m up and 120 m away: 45 degrees, 169.7 m, 84.77 dB; over a town a chance of 0.9677, so 1.61 dB more."""
    assert study.received_over("urban", 120.0) == pytest.approx(20.0 - 84.77 - 1.61, abs=0.02)


@pytest.mark.long
def test_packets_arrive_as_the_closed_forms_say() -> None:
    found = study.run(full=False)
    assert found["outside"] == 0
    for values in (*found["presets"].values(), *found["lands"].values()):
        assert values["largest_difference"] < 0.04
    for values in found["aloha"].values():
        assert values["arrives"] == pytest.approx(values["law"], rel=0.05)
