"""``qrsim run --policy`` and ``--estimator``: what is flown, and what is left when a user's function fails."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.small_worlds import pair

from qrsim import cli
from qrsim.runs import open_run, recorder
from qrsim.runs.streams import values

TICKS = 150
POLICIES = '''
"""A user's own functions."""
from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

import qrsim


@dataclass
class Gains:
    drift: float = 0.05


def lean(reading):
    drift = np.asarray(reading.gnss.position_ned)[:, 1] - np.array([0.0, 9.0])
    command = np.tile([0.0, 0.0, 0.59, 0.2, 12.0], (2, 1))
    command[:, 1] = -Gains().drift * drift
    return command


@jax.jit
def compiled(reading):
    drift = reading.gnss.position_ned[:, 1] - jnp.asarray([0.0, 9.0], jnp.float32)
    still = jnp.zeros(2, jnp.float32)
    return jnp.stack([still, -0.05 * drift, still + 0.59, still + 0.2, still + 12.0], axis=-1)


def southwards(reading):
    return qrsim.VelocitySetpoint.of(np.array([[-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]))


def fails(reading):
    if reading.time > 1.39:
        raise RuntimeError("the sky fell")
    return lean(reading)


def too_much(reading):
    command = lean(reading)
    command[1, 2] = 0.59 if reading.time < 1.39 else 1.5
    return command


def shifted(reading):
    place = np.array(reading.gnss.position_ned) + [2.0, 0.0, 0.0]
    place[:, 2] = -reading.barometer.height
    velocity = np.array(reading.gnss.velocity_ned)
    return qrsim.Estimate.of(place, velocity, reading.attitude.attitude)
'''


@pytest.fixture(scope="module")
def policies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("policies") / "pilot_of_a_test.py"
    file.write_text(POLICIES)
    return file


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp("scenario") / "pair.yaml"
    file.write_text(pair(duration=TICKS * 0.02).to_yaml())
    return str(file)


@pytest.fixture(scope="module")
def flown(fly: Callable[..., object], scenario: str, policies: Path) -> Callable[..., object]:
    """Fly with one of the policies, without a figure."""

    def run(*words: str) -> object:
        return fly(scenario, "--no-figure", *(word.replace("FILE", str(policies)) for word in words))

    return run


def column(folder: Path, stream: str, name: str) -> np.ndarray:
    return open_run(folder)[stream][name]


class TestFlights:
    def test_numpy_and_compiled_fly_the_same(self, flown):
        one, two = flown("--policy", "FILE:lean"), flown("--policy", "FILE:compiled")
        assert (one.code, two.code) == (0, 0)
        assert open_run(one.folder).info.state == "finished"
        for axis in "xyz":
            places = [column(run.folder, "truth", f"position_ned.{axis}") for run in (one, two)]
            assert places[0].shape == (TICKS + 1, 2)
            np.testing.assert_allclose(*places, atol=1e-4)
        np.testing.assert_allclose(column(one.folder, "commands", "yaw_rate")[1:], 0.2, atol=1e-6)

    def test_asked_at_every_tenth_tick(self, flown):
        run = flown("--policy", "FILE:lean", "--policy-ticks", "10")
        assert run.code == 0
        roll = column(run.folder, "commands", "roll")[1:, 0].reshape(-1, 10)
        np.testing.assert_array_equal(roll, np.tile(roll[:, :1], 10))
        assert len(np.unique(roll[:, 0])) > 3

    def test_ticks_are_logged_fifty_at_a_time(self, flown, monkeypatch):
        """Not one by one: that takes ten times as long as to fly a tick."""
        lengths = []

        def counted(world, history, wanted):
            lengths.append(len(history.ticks))
            return values(world, history, wanted)

        monkeypatch.setattr(recorder, "values", counted)
        monkeypatch.setattr(recorder, "CHUNK_S", 60.0)
        run = flown("--policy", "FILE:lean")
        # The start, and the first tick.
        assert lengths == [1, 1, 50, 50, 49]
        # Those of a slow function are not kept waiting.
        monkeypatch.setattr(recorder, "CHUNK_S", 0.0)
        lengths.clear()
        flown("--policy", "FILE:lean", "--duration", "0.2")
        assert lengths == [1] * 11
        assert open_run(run.folder)["truth"].tick.tolist() == list(range(TICKS + 1))

    @pytest.mark.long
    def test_set_points_and_estimators(self, flown):
        south = flown("--policy", "FILE:southwards")
        assert np.all(column(south.folder, "truth", "position_ned.x")[-1] < -1.0)
        ahead, shifted = flown(), flown("--estimator", "FILE:shifted")
        assert shifted.code == 0
        ends = [column(run.folder, "truth", "position_ned.x")[-1] for run in (ahead, shifted)]
        assert np.all(ends[1] < ends[0] - 0.5)


class TestFailures:
    @pytest.mark.parametrize(
        ("name", "code", "message"),
        [
            ("fails", 1, "policy fails, at tick 70 (1.4 s): RuntimeError: the sky fell"),
            (
                "too_much",
                2,
                "policy too_much, at tick 70 (1.4 s): command: throttle of vehicle 1 ('vehicles_1') is 1.5",
            ),
        ],
    )
    def test_leave_a_readable_log(self, flown, name: str, code: int, message: str):
        run = flown("--policy", f"FILE:{name}")
        assert run.code == code
        assert message in run.complaints
        assert "Traceback" not in run.complaints
        recorded = open_run(run.folder)
        assert recorded.info.state == "failed"
        assert recorded["truth"].tick[-1] == 70
        assert np.all(np.isfinite(column(run.folder, "truth", "position_ned.x")))

    def test_at_the_first_tick_nothing_is_left(self, scenario, tmp_path, refused):
        file = tmp_path / "never.py"
        file.write_text("def fly(reading):\n    return [1, 2]\n")
        folder = tmp_path / "run"
        refused(
            ["run", scenario, "--policy", f"{file}:fly", "--out", str(folder)],
            "policy fly, at tick 0 (0 s): command: expected shape (2, 5)",
        )
        assert not folder.exists()

    @pytest.mark.parametrize(
        ("words", "parts"),
        [
            (["--policy", "hover"], ["policy hover: expected module:function or file.py:function"]),
            (["--policy", "FILE:leen"], ["has no 'leen'; did you mean 'lean'"]),
            (["--policy", "FILE:Gains"], ["Gains: objects of this class cannot be called; give it __call__"]),
            (["--estimator", "not_a_module_at_all:f"], ["no module is called 'not_a_module_at_all'"]),
            (["--policy", "FILE:lean", "--policy-ticks", "0"], ["policy_ticks: 0 is not a positive whole number"]),
            (["--policy-ticks", "4"], ["--policy-ticks 4: there is no --policy"]),
        ],
    )
    def test_refused_before_anything_is_flown(self, refused, scenario, policies, tmp_path, words, parts):
        words = [word.replace("FILE", str(policies)) for word in words]
        refused(["run", scenario, *words, "--out", str(tmp_path / "run")], *parts)
        assert not (tmp_path / "run").exists()


def test_help_names_them(capsys):
    assert cli.main(["run", "--help"]) == 0
    printed = capsys.readouterr().out
    for option in ("--policy", "--estimator", "--policy-ticks"):
        assert option in printed
