"""The examples of docs/reference/contracts.md: each a file beside its scenario, flown as a user would."""

from __future__ import annotations

import hashlib
import json
import pickle
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import qrsim
from qrsim import cli
from qrsim.envs.single import SingleTask
from qrsim.errors import UsageError
from qrsim.files import code
from qrsim.links.reference.readout import Readout
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation
from qrsim.studies.sweep.flying import dumped
from qrsim.studies.sweep.groups import make_group

EXAMPLES = Path(__file__).parents[1] / "examples" / "outside"
DOCS = EXAMPLES.parents[1] / "docs"
LASER = EXAMPLES / "laser.yaml"


def test_the_page_shows_the_laser():
    page = (DOCS / "howto" / "own_component.md").read_text(encoding="utf-8")
    assert f"```python\n{(EXAMPLES / 'laser.py').read_text(encoding='utf-8')}```" in page


@pytest.mark.parametrize(
    ("name", "below"),
    [
        ("laser", 30),
        ("point_mass", 45),
        ("climb", 35),
        ("lean", 35),
        ("circle", 35),
        ("jet", 25),
        ("puffs", 25),
        ("smooth", 25),
        ("band", 35),
        ("udp_link", 70),
    ],
)
def test_they_are_short(name: str, below: int):
    assert len((EXAMPLES / f"{name}.py").read_text(encoding="utf-8").splitlines()) < below


class TestLaser:
    def test_what_it_reads(self):
        """At 10 m, over level ground, with noise of 2 cm; a tenth of the pulses are lost: 99.9 % of 2000 draws."""
        simulation = Simulation(
            load_scenario(LASER, ["fleets.pelicans.sensors.laser.dropouts=0.1"]).world(), seed=1, name="laser"
        )
        simulation.reset()
        ranges = np.concatenate([simulation.step(ticks=5).laser.range for _ in range(2000)])
        assert 0.1 - 3.3 * 0.0067 < np.isnan(ranges).mean() < 0.1 + 3.3 * 0.0067
        assert np.nanmean(ranges) == pytest.approx(10.0, abs=0.05)
        assert np.nanstd(ranges) == pytest.approx(0.02, rel=0.15)

    def test_a_run_folder(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
        """It says what it needs, and is read where that is no more."""
        folder = tmp_path / "own"
        folder.mkdir()
        for name in ("laser.py", "laser.yaml"):
            (folder / name).write_bytes((EXAMPLES / name).read_bytes())
        run = tmp_path / "run"
        assert cli.main(["run", str(folder / "laser.yaml"), "--duration", "1", "--out", str(run), "--no-figure"]) == 0
        (needed,) = json.loads((run / "run.json").read_text())["components"]
        file = folder / "laser.py"
        assert needed["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
        assert needed | {"sha256": "", "class": "", "from": ""} == {
            "path": "fleets.pelicans.sensors.laser",
            "kind": "sensor",
            "type": f"{file}:Laser",
            "file": str(file),
            "sha256": "",
            "class": "",
            "from": "",
        }
        file.unlink()
        found = qrsim.open_run(run)
        assert found.info.components[0]["kind"] == "sensor"
        column = next(c for c in found.describe("measurements") if c.name == "laser.range")
        assert (column.unit, column.dtype) == ("m", "float32")
        capsys.readouterr()
        panel = ["--panel", "measurements.laser.range"]
        assert cli.main(["plot", str(run), "--out", str(tmp_path / "a.png"), *panel]) == 0
        assert cli.main(["export", str(run), "--format", "csv", "--out", str(tmp_path / "csv")]) == 0

    @pytest.mark.long
    def test_a_rollout_and_a_saved_state(self):
        flights = qrsim.rollout(str(LASER), ticks=50, worlds=2)
        assert flights.metrics["reason"].tolist() == [[0], [0]]
        one, two = (qrsim.load(LASER, seed=3) for _ in range(2))
        one.reset()
        one.step(ticks=10)
        two.reset()
        two.load(one.save())
        np.testing.assert_array_equal(one.step(ticks=20).laser.range, two.step(ticks=20).laser.range)

    @pytest.mark.long
    def test_a_worker_of_a_sweep(self, tmp_path: Path):
        """A process that has not loaded the file reads what it is handed."""
        group = make_group(load_scenario(LASER).spec.model_dump(mode="json"), {}, [], "float32")
        (tmp_path / "group").write_bytes(dumped(group))
        program = (
            "from pathlib import Path\nfrom qrsim.studies.sweep.flying import _group\n"
            f"world = _group(Path({str(tmp_path / 'group')!r}).read_bytes()).world\n"
            "print(type(world.fleets[0].sensors[-1]).__name__)"
        )
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=120)
        assert done.stdout.strip() == "Laser"
        assert pickle.loads(pickle.dumps(load_scenario(LASER))) == load_scenario(LASER)


class TestClimb:
    def test_an_episode(self):
        """Who climbs at half of what is missing is there in the end, and has paid for the way: 10 m at up to 2 m/s."""
        task = SingleTask(str(EXAMPLES / "climb.yaml"))
        seen, _ = task.reset(seed=1)
        total, ended = 0.0, False
        while not ended:
            seen, reward, terminated, ended, _ = task.step(np.clip(seen[:1] * 0.5, -1.0, 1.0).astype(np.float32))
            assert not terminated
            total += reward
        assert abs(seen[0]) < 0.5
        assert -40.0 < total < -25.0

    def test_it_is_checked_against_its_scenario(self):
        with pytest.raises(UsageError, match=r"task.fleet: no fleet is called 'pelican'; did you mean 'pelicans'"):
            load_scenario(EXAMPLES / "climb.yaml", ["task.fleet=pelican"])
        with pytest.raises(UsageError, match=r"'attitude' does not take what the task .*climb.py:Climb' asks for"):
            load_scenario(EXAMPLES / "climb.yaml", ["fleets.pelicans.controller=attitude"])


@pytest.mark.long
class TestPointMass:
    def test_it_flies_the_loops_of_the_quadrotor(self):
        """Its weight is carried at the throttle that says so, and three legs of 40 m are flown in a minute."""
        scenario = load_scenario(EXAMPLES / "point_mass.yaml", ["duration=60"])
        flights = qrsim.rollout(scenario, worlds=2, seed=1)
        assert (flights.metrics["reason"] == 0).all()
        assert (flights.metrics["tracking_error_rms_m"] < 6.0).all()
        assert (flights.metrics["distance_m"] > 120.0).all()

    def test_a_client_sees_it(self):
        """A STATE has NaN for the thrust, which is not in its state."""
        simulation = qrsim.load(EXAMPLES / "point_mass.yaml")
        simulation.reset()
        state = Readout(simulation).message()
        rows = np.array([list(row.value) for row in state.X])
        assert np.isnan(rows[:, 12]).all()
        np.testing.assert_array_equal(rows[:, :3], simulation.truth.position_ned)

    def test_in_both_precisions_it_falls_as_a_mass_does(self):
        """Without throttle and drag: 9.81 m/s^2, for half a second."""
        for precision in ("float32", "float64"):
            simulation = qrsim.load(
                EXAMPLES / "point_mass.yaml",
                precision=precision,
                overrides=["fleets.pelicans.vehicle.drag=0", "world.wind=calm", "world.turbulence=still"],
            )
            simulation.reset()
            simulation.step([[0.0, 0.0, 0.0, 0.0, 12.0]] * 5, ticks=25)
            np.testing.assert_allclose(simulation.truth.velocity_ned[:, 2], 9.81 * 0.5, rtol=1e-5)
            np.testing.assert_allclose(simulation.truth.thrust, 1.5 * 9.81, rtol=1e-6)


@pytest.mark.parametrize(
    "kind", ["sensor", "vehicle", "wind", "turbulence", "controller", "guidance", "estimator", "task", "metric", "link"]
)
def test_every_contract_has_an_example_that_the_page_names(kind: str):
    page = (DOCS / "reference" / "contracts.md").read_text(encoding="utf-8")
    (row,) = [line for line in page.splitlines() if re.match(rf"\| `?{kind}\b", line)]
    (name,) = re.findall(r"examples/outside/(\w+\.py)`", row)
    assert (EXAMPLES / name).is_file()


def test_a_controller_reaches_its_waypoint():
    simulation = qrsim.load(EXAMPLES / "lean.yaml")
    simulation.reset()
    simulation.step(simulation.waypoint([10.0, 5.0, -12.0]), ticks=1500)
    np.testing.assert_allclose(simulation.truth.position_ned, [[10.0, 5.0, -12.0]], atol=0.1)


def test_a_guidance_flies_a_circle():
    """Of 10 m, at 2 m/s, whose set-point a vehicle follows from behind and inside."""
    simulation = qrsim.load(EXAMPLES / "circle.yaml")
    simulation.reset()
    for _ in range(4):
        simulation.step(ticks=400)
        assert np.hypot(*simulation.truth.position_ned[0, :2]) == pytest.approx(10.0, abs=1.0)
        assert np.hypot(*simulation.truth.velocity_ned[0, :2]) == pytest.approx(2.0, abs=0.3)


def test_a_wind_blows_as_its_profile_says():
    """At 10 m 6 * (10/60) exp(1 - 10/60) m/s, to the east and turning south by 1e-4 rad/s."""
    simulation = qrsim.load(EXAMPLES / "jet.yaml")
    simulation.reset()
    simulation.step(ticks=500)
    np.testing.assert_allclose(simulation.truth.wind_ned, [[-0.0033, 2.301, 0.0]], atol=0.02)


@pytest.mark.long
def test_a_turbulence_is_stationary_and_decays():
    """Ornstein-Uhlenbeck: 1.2 m/s, and exp(-1) of it after 2 s; 20 000 s have a relative error of about 1 %."""
    scenario = load_scenario(
        EXAMPLES / "puffs.yaml",
        ["duration=20000", "fleets.pelicans.sensors={}", "fleets.pelicans.controller={type: waypoint, feed: truth}"],
    )
    simulation = Simulation(scenario.world(), seed=1)
    simulation.reset()
    gusts = np.array([(simulation.advance(ticks=50), simulation.truth.wind_ned[0])[1] for _ in range(20000)])
    np.testing.assert_allclose(gusts.std(axis=0), 1.2, rtol=0.05)
    np.testing.assert_allclose(gusts.mean(axis=0), 0.0, atol=0.07)
    after = np.mean(gusts[2:] * gusts[:-2], axis=0) / gusts.var(axis=0)
    np.testing.assert_allclose(after, np.exp(-1.0), atol=0.05)


def test_an_estimator_and_a_metric_by_their_files():
    """A hover: nobody leaves the band by more than a metre, and the place that is believed is the true one."""
    flown = qrsim.rollout(
        "hover_ideal",
        ticks=100,
        worlds=2,
        estimator=f"{EXAMPLES / 'smooth.py'}:SmoothVelocity",
        metrics=f"{EXAMPLES / 'band.py'}:HeightBand",
        overrides=["fleets.pelicans.vehicles.0.position_ned.2=-21.5"],
    )
    np.testing.assert_allclose(flown["outside_band_s"], 2.0, atol=0.03)
    np.testing.assert_allclose(flown["from_middle_max_m"], 1.5, atol=0.1)


class TestLink:
    def test_a_vehicle_obeys_lines_of_text_and_holds_in_silence(self):
        own = code.load_object("link", f"{EXAMPLES / 'udp_link.py'}:UdpLink")
        simulation = qrsim.load("hover_ideal", overrides=["fleets.pelicans.controller=offboard"])
        simulation.reset()
        link = own(simulation, "pelicans_0")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.settimeout(10)
            client.connect(("127.0.0.1", link.socket.getsockname()[1]))

            def asked(line: bytes) -> str:
                client.send(line)
                link.step()
                return client.recv(512).decode()

            for wrong, said in (
                (b"velocty 1 0 0 0", "error: 'pelicans_0' takes no order of kind 'velocty'; did you mean 'velocity'"),
                (b"velocity 1", "error: 'pelicans_0': velocity: 1 numbers; expected 4"),
                (b"velocity nan 0 0 0", "error: 'pelicans_0': velocity: velocity_north is nan"),
                (b"\xff\xfe", "error: "),
                (b"", "error: "),
            ):
                assert asked(wrong).startswith(said)
            for _ in range(250):
                numbers = asked(b"velocity 1 0 0 0").split()
            assert float(numbers[3]) == pytest.approx(1.0, abs=0.1)
        link.step(ticks=1)
        for _ in range(400):
            link.step()
        np.testing.assert_allclose(simulation.truth.velocity_ned, 0.0, atol=0.05)
        link.socket.close()

    @pytest.mark.long
    def test_it_runs_as_a_program(self):
        done = subprocess.run(
            [sys.executable, str(EXAMPLES / "udp_link.py"), "0.2"], capture_output=True, text=True, timeout=120
        )
        assert (done.returncode, done.stderr) == (0, "")
