"""A saved state continues as if nothing had happened, and nothing else is taken for one."""

from __future__ import annotations

import errno
import io
import os
import subprocess
import sys
import time
import tracemalloc
import zipfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests import small_worlds
from tests.wrong_input.states import attempt, mutants

import qrsim
from qrsim.errors import RunError, UsageError
from qrsim.simulation.simulation import Simulation

SCENARIO = "patrol_plain"


@pytest.fixture(scope="module")
def flown() -> tuple[bytes, bytes]:
    """A state saved after 73 ticks, and the same simulation's state 50 ticks later."""
    simulation = qrsim.load(SCENARIO, seed=5)
    simulation.reset()
    simulation.step(ticks=73)
    saved = simulation.save()
    simulation.step(ticks=50)
    return saved, simulation.save()


@pytest.mark.long
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
    with pytest.raises(UsageError, match="of the scenario 'patrol_plain', this simulation is 'hover_ideal'"):
        qrsim.load("hover_ideal").load(flown[0])
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
    with pytest.raises(UsageError, match=r"it has 7 floats, this simulation's state \d+: it is of another version"):
        simulation.load(rewritten(flown[0], floats=np.zeros(7, np.float32)))
    # What was refused has changed nothing.
    with pytest.raises(UsageError, match="call reset"):
        simulation.step()
    assert simulation.load(flown[0]).time == pytest.approx(73 * 0.02)


def test_missing_file_and_save_before_the_start(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"nowhere\.npz: cannot be read"):
        qrsim.load("hover_ideal").load("nowhere.npz")
    with pytest.raises(UsageError, match=r"cannot be read: it is not a regular file"):
        qrsim.load("hover_ideal").load("/dev/zero")
    with pytest.raises(UsageError, match=r"expected bytes or the path of a file, found int"):
        qrsim.load("hover_ideal").load(7)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="call reset"):
        qrsim.load("hover_ideal").save()
    # Larger than any state, and not read: it takes no room on the disk.
    with (tmp_path / "large").open("wb") as file:
        file.truncate(2**33)
    with pytest.raises(UsageError, match=r"8589934592 bytes; a saved state has at most 268435456"):
        qrsim.load("hover_ideal").load(tmp_path / "large")


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    """One simulation for everything that is refused."""
    return qrsim.load(SCENARIO, seed=1)


def with_float(data: bytes, simulation: Simulation, pick: Any, value: float) -> bytes:
    """The archive with one number of the state replaced: the first of the leaf that is picked."""
    with np.load(io.BytesIO(data)) as archive:
        floats, integers = archive["floats"], archive["integers"]
    layout = simulation.packed[0]
    number = pick(layout.numbers)
    buffer = floats if layout.is_float[number] else integers
    buffer[layout.slices[number].start] = value
    return rewritten(data, floats=floats, integers=integers)


@pytest.mark.parametrize("dtype", ["int8", "bool", "float16", "float64", "int32", "complex64", ">f4"])
def test_floats_of_another_type(simulation: Simulation, flown: tuple[bytes, bytes], dtype: str) -> None:
    with np.load(io.BytesIO(flown[0])) as archive:
        count = archive["floats"].size
    with pytest.raises(UsageError, match=r"saved state: its floats are .*"):
        simulation.load(rewritten(flown[0], floats=np.zeros(count, dtype)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tick": -1}, "its tick is -1; expected a whole number from 0 to 2147483646"),
        ({"tick": 2**40}, "its tick is 1099511627776; expected"),
        ({"tick": 1.5}, "its tick is float64; expected a whole number"),
        ({"seed": -1}, "its seed is -1; expected a whole number from 0 to 9223372036854775807"),
        ({"seed": 6}, "its randomness is not that of its seed, 6"),
        ({"number": 2**32}, "its number is 4294967296; expected a whole number from 0 to 4294967295"),
        ({"number": 1}, "its randomness is not that of its seed, 5"),
        ({"name": 3}, "its name is no text"),
        ({"name": "hover"}, "of the scenario 'hover', this simulation is 'patrol_plain'"),
        ({"name": [SCENARIO]}, "its name is no text"),
        ({"more": 1}, "another version of qrsim, or not by qrsim"),
        ({"floats": np.array([[1, "x"]], object)}, "no state that qrsim saved, or it is damaged"),
        (
            {"integers": np.zeros((0, 3), np.int32)},
            r"its integers are int32 of shape \(0, 3\); expected int32, one row",
        ),
    ],
)
def test_wrong_numbers(
    simulation: Simulation, flown: tuple[bytes, bytes], changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        simulation.load(rewritten(flown[0], **changes))


@pytest.mark.parametrize(
    ("pick", "value", "message"),
    [
        (lambda s: s.sky.satellites_ned.x, np.nan, "the sky is not finite"),
        (lambda s: s.fleets[0].vehicle.position_ned.x, np.nan, "the vehicle of fleet 0 is not finite"),
        (lambda s: s.fleets[0].vehicle.thrust, np.inf, "the vehicle of fleet 0 is not finite"),
        (lambda s: s.fleets[0].estimate.position_ned.z, np.nan, "the estimate of fleet 0 is not finite"),
        (lambda s: s.fleets[0].readings[0].position_ned.x, np.inf, "sensors of fleet 0 remembers is not finite"),
        (lambda s: s.fleets[0].setpoint.yaw, -np.inf, "controller of fleet 0 remembers is not finite"),
        (lambda s: s.fleets[0].violation.code, 99, "why a vehicle stopped, of fleet 0, is 99; allowed: 0 to 23"),
        (lambda s: s.fleets[0].guidance.index, 4, "number of a waypoint of fleet 0 is 4; allowed: 0 to 3"),
        (lambda s: s.fleets[0].command_clipped, 7, "7 is neither 0 nor 1"),
        (lambda s: s.fleet_keys[0].high, 1, "its randomness is not that of its seed, 5"),
    ],
)
def test_what_no_simulation_can_be_in(
    simulation: Simulation, flown: tuple[bytes, bytes], pick: Any, value: float, message: str
) -> None:
    simulation.load(flown[0])
    with pytest.raises(UsageError, match=f"damaged: .*{message}|{message}"):
        simulation.load(with_float(flown[0], simulation, pick, value))
    # What was refused has changed nothing.
    assert simulation.save() == flown[0]


def test_the_state_of_vehicles_that_have_stopped_is_taken() -> None:
    """Their readings are NaN, and so may be what was asked of them."""
    started = small_worlds.simulate(small_worlds.quiet(), seed=2)
    beyond = started.truth.position_ned
    started.step(np.tile([0.6, 0.0, 0.9, 0.0, 12.0], (started.size, 1)), ticks=400)
    assert not started.valid.all()
    again = small_worlds.simulate(small_worlds.quiet(), seed=3)
    again.load(started.save())
    assert again.reasons == started.reasons
    assert np.abs(again.truth.position_ned - beyond).max() > 1.0


def test_a_bomb_is_not_opened(simulation: Simulation, flown: tuple[bytes, bytes]) -> None:
    """A thousand million zeros in a megabyte."""
    buffer = io.BytesIO()
    with np.load(io.BytesIO(flown[0])) as archive, zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as bomb:
        for name in archive.files:
            with bomb.open(f"{name}.npy", "w") as file:
                np.save(file, archive[name] if name != "floats" else np.zeros(2**26, np.float32))
    tracemalloc.start()
    with pytest.raises(UsageError, match="no state that qrsim saved, or it is damaged"):
        simulation.load(buffer.getvalue())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**22


@pytest.mark.long
def test_300_mutants(simulation: Simulation, flown: tuple[bytes, bytes]) -> None:
    """The small form of the fuzz study: each is refused in one line or flown, in less than 2 s of computing."""
    results = Counter()
    for kind, data in mutants(flown[0], seed=20, count=300):
        begun = time.process_time()
        results[attempt(simulation, data)] += 1
        assert time.process_time() - begun < 2.0, kind
    # There is no study of what is always refused, nor of what never is.
    assert results["refused"] > 200
    assert results["taken"] > 10


def test_a_full_disk_leaves_the_file_that_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sim = qrsim.load("hover_ideal")
    sim.reset()
    path = tmp_path / "state"
    before = sim.save(path)
    sim.step()

    def full(number: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(RunError, match="No space left on device"):
        sim.save(path)
    assert [each.name for each in tmp_path.iterdir()] == ["state"]
    assert path.read_bytes() == before
