"""A saved state continues as if nothing had happened, and nothing else is taken for one."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import qrsim
from qrsim.errors import UsageError

SCENARIO = "outdoor_patrol"


@pytest.fixture(scope="module")
def flown() -> tuple[bytes, bytes]:
    """A state saved after 73 ticks, and the same simulation's state 50 ticks later."""
    simulation = qrsim.load(SCENARIO, seed=5)
    simulation.reset()
    simulation.step(ticks=73)
    saved = simulation.save()
    simulation.step(ticks=50)
    return saved, simulation.save()


def test_continues_bit_for_bit_in_a_new_process(flown: tuple[bytes, bytes], tmp_path: Path) -> None:
    (tmp_path / "state.npz").write_bytes(flown[0])
    program = (
        f"import qrsim; s = qrsim.load({SCENARIO!r}, seed=99); s.load('state.npz'); s.step(ticks=50); s.save('end.npz')"
    )
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True, timeout=300)
    with np.load(tmp_path / "end.npz") as found:
        assert int(found["tick"]) == 123
        assert int(found["seed"]) == 5
    assert (tmp_path / "end.npz").read_bytes() == flown[1]


def test_load_gives_the_reading_of_then(flown: tuple[bytes, bytes]) -> None:
    simulation = qrsim.load(SCENARIO, seed=0)
    reading = simulation.load(flown[0])
    assert reading.time == pytest.approx(73 * 0.02)
    assert simulation.tick == 73
    assert np.all(np.isfinite(reading.gnss.position_ned))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: b"", "no state that qrsim saved"),
        (lambda data: b"PK" + data[2:400], "no state that qrsim saved"),
        (lambda data: data[: len(data) // 2], "no state that qrsim saved"),
    ],
)
def test_damaged(flown: tuple[bytes, bytes], change: object, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        qrsim.load(SCENARIO).load(change(flown[0]))  # type: ignore[operator]


def test_of_another_scenario_or_with_other_parameters(flown: tuple[bytes, bytes]) -> None:
    with pytest.raises(UsageError, match="of the scenario 'outdoor_patrol', this simulation is 'hover'"):
        qrsim.load("hover").load(flown[0])
    with pytest.raises(UsageError, match="with other parameters"):
        qrsim.load(SCENARIO, overrides=["world.wind.speed_20ft=6"]).load(flown[0])
    with pytest.raises(UsageError, match="with other parameters"):
        qrsim.load(SCENARIO, precision="float64").load(flown[0])


def rewritten(data: bytes, **changes: object) -> bytes:
    """The archive with some entries replaced."""
    with np.load(io.BytesIO(data)) as archive:
        content = {name: archive[name] for name in archive.files}
    buffer = io.BytesIO()
    np.savez(buffer, **{**content, **changes})  # type: ignore[arg-type]
    return buffer.getvalue()


def test_of_another_version(flown: tuple[bytes, bytes]) -> None:
    simulation = qrsim.load(SCENARIO)
    with pytest.raises(UsageError, match="another version"):
        simulation.load(rewritten(flown[0], format=1))
    with pytest.raises(UsageError, match="another version"):
        simulation.load(rewritten(flown[0], floats=np.zeros(7, np.float32)))
    # What was refused has changed nothing.
    assert simulation.load(flown[0]).time == pytest.approx(73 * 0.02)


def test_missing_file_and_save_before_the_start() -> None:
    with pytest.raises(UsageError, match=r"nowhere\.npz: cannot be read"):
        qrsim.load("hover").load("nowhere.npz")
    with pytest.raises(UsageError, match="call reset"):
        qrsim.load("hover").save()
