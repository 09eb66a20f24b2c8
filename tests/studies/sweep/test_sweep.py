"""Sweeps in one process: results, stores that go on, and what can go wrong with them."""

from __future__ import annotations

import errno
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.studies.sweep.conftest import flown, planned, write
from tests.studies.sweep.killing import opened, same

import qrsim
from qrsim.cli import main
from qrsim.errors import RunError, UsageError
from qrsim.studies.sweep import store as stores
from qrsim.studies.sweep.report import replay
from qrsim.studies.sweep.results import Results
from qrsim.studies.sweep.store import Store
from qrsim.studies.sweep.sweeping import sweep_here

WIND, MASS = "world.wind.speed_20ft", "fleets.pelicans.vehicle.mass"


@pytest.mark.long
def test_an_episode_is_what_a_rollout_of_its_scenario_flies(tmp_path: Path) -> None:
    data = opened(flown(tmp_path))
    assert data["tracking_error_rms_m"].dims == ("wind", "mass", "seed")
    assert data["tracking_error_rms_m"].attrs["units"] == "m"
    assert data["wind"].attrs == {"path": WIND, "units": "m/s"}
    assert data["flown"].values.all()
    setting = planned(tmp_path).study.content
    for wind, mass, seed in [(0.0, 1.5, 0), (4.0, 1.8, 4), (2.0, 1.6, 3)]:
        mass = float(data["mass"].sel(mass=mass, method="nearest"))
        scenario = qrsim.load_scenario(setting, [f"{WIND}={wind!r}", f"{MASS}={mass!r}"])
        alone = qrsim.rollout(scenario.world(), ticks=scenario.ticks, seeds=[seed])
        here = data.sel(wind=wind, mass=mass, seed=seed)
        assert np.float32(alone["tracking_error_rms_m"][0, 0]) == here["tracking_error_rms_m"].values
        assert np.float32(alone["wind_max_m_s"][0, 0]) == here["wind_max_m_s"].values


@pytest.mark.long
def test_batches_of_another_size_give_the_same_results(tmp_path: Path) -> None:
    one = opened(flown(tmp_path, "one.zarr", batch=5))
    other = opened(flown(tmp_path, "other.zarr", batch=60))
    for name in one.data_vars:
        np.testing.assert_array_equal(one[name].values, other[name].values)


@pytest.mark.long
def test_a_store_that_was_left_goes_on_and_is_the_same(tmp_path: Path) -> None:
    whole = opened(flown(tmp_path, "whole.zarr"))
    plan = planned(tmp_path)
    left = Store(tmp_path / "left.zarr", plan)
    left.done[3:] = True
    sweep_here(plan, left)
    left.close()
    half = opened(tmp_path / "left.zarr")
    # What is there can be read, and what is not is known.
    assert int(half["flown"].sum()) == 15
    assert np.isfinite(half["wind_max_m_s"].values[half["flown"].values]).all()
    assert np.isnan(half["wind_max_m_s"].values[~half["flown"].values]).all()
    # As a kill leaves it: a file half written, and a batch whose last file is missing.
    (tmp_path / "left.zarr" / "wind_max_m_s" / "c" / "1.abc.partial").write_bytes(b"half")
    (tmp_path / "left.zarr" / "flown" / "c" / "0" / "1" / "0").unlink()
    again = Store(tmp_path / "left.zarr", plan)
    assert again.done.sum() == 2
    sweep_here(plan, again)
    again.close()
    assert same(opened(tmp_path / "left.zarr"), whole)
    assert not list((tmp_path / "left.zarr").rglob("*.partial"))


def test_a_full_disk_is_told_and_what_was_written_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from zarr.storage import _local

    plan = planned(tmp_path)
    store = Store(tmp_path / "full.zarr", plan)
    written = []
    put = _local._put

    def full(path: Path, value: Any, exclusive: bool = False) -> int:
        written.append(path)
        if len(written) > 10:
            raise OSError(errno.ENOSPC, "No space left on device")
        return put(path, value, exclusive)

    monkeypatch.setattr(_local, "_put", full)
    with pytest.raises(RunError, match=r"full\.zarr: batch 3 of 12 cannot be written: No space left on device; the 2 "):
        sweep_here(plan, store)
    store.close()
    monkeypatch.undo()
    assert int(opened(tmp_path / "full.zarr")["flown"].sum()) == 10
    again = Store(tmp_path / "full.zarr", plan)
    sweep_here(plan, again)
    again.close()
    assert same(opened(tmp_path / "full.zarr"), opened(flown(tmp_path, "whole.zarr")))


def test_a_store_that_cannot_be_made_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Store, "_write_frame", full)
    with pytest.raises(RunError, match="the store cannot be written: No space left on device"):
        Store(tmp_path / "none.zarr", planned(tmp_path))
    assert [item.name for item in tmp_path.iterdir()] == ["study.yaml"]


def test_a_store_of_another_study_is_refused_with_what_differs(tmp_path: Path) -> None:
    path = flown(tmp_path)
    with pytest.raises(UsageError) as caught:
        Store(path, planned(tmp_path, seeds=6, set={"duration": 2.0}, vary={MASS: {"values": [1.5]}}))
    said = str(caught.value)
    assert "store.zarr: this is a store of another study" in said
    assert "seeds: 6 here, 5 in the store" in said
    assert "scenario.duration: 2.0 here, 1.0 in the store" in said


def test_a_store_of_other_versions_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = flown(tmp_path)
    monkeypatch.setattr(stores, "versions", lambda: {"qrsim": "9.9"})
    with pytest.raises(UsageError, match=r"begun with other versions[^$]*qrsim: 9\.9 here, .* there"):
        Store(path, planned(tmp_path))


def test_what_is_no_store_is_refused_and_left_alone(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "mine.txt").write_text("mine")
    with pytest.raises(UsageError, match="exists and is no store of a sweep"):
        Store(other, planned(tmp_path))
    assert (other / "mine.txt").read_text() == "mine"


def test_two_processes_do_not_write_to_one_store(tmp_path: Path) -> None:
    plan = planned(tmp_path)
    first = Store(tmp_path / "one.zarr", plan)
    with pytest.raises(RunError, match="another process writes to this store"):
        Store(tmp_path / "one.zarr", plan)
    first.close()
    Store(tmp_path / "one.zarr", plan).close()


def test_a_batch_that_cannot_be_flown_is_named(tmp_path: Path) -> None:
    places = {
        "fleets.pelicans.placement": {"type": "ring", "apart": 35.0, "nearest": 19.0, "farthest": 20.0, "tries": 1}
    }
    pair = {"fleets.pelicans.vehicles": [{"position_ned": [0.0, 9.0 * i, -10.0]} for i in range(2)]}
    plan = planned(tmp_path, set={"duration": 1.0} | places | pair, vary={MASS: {"values": [1.5, 1.6]}})
    store = Store(tmp_path / "store.zarr", plan)
    with pytest.raises(RunError, match=r"batch 1: .*no place for 2 vehicles.*the 0 batches written before are kept"):
        sweep_here(plan, store)
    store.close()


@pytest.mark.parametrize("named", [True, False])
@pytest.mark.long
def test_the_command_of_an_episode_flies_it_again(tmp_path: Path, named: bool, capsys: Any) -> None:
    source = {"scenario": "hover"} if named else {"scenario": {"extends": "hover_ideal", "description": "own"}}
    results = Results(flown(tmp_path, first_seed=3, **source))
    (tmp_path / "report").mkdir()
    from qrsim.scenarios.reading import dump_yaml

    (tmp_path / "report" / "scenario.yaml").write_text(dump_yaml(results.scenario))
    episode = int(np.argmax(results.metric("wind_max_m_s")))
    words, _, look = replay(results, episode, tmp_path / "report").partition(" && ")
    assert look.startswith("qrsim view ")
    assert main([*shlex.split(words)[1:], "--no-figure", "--json"]) == 0
    (vehicle,) = json.loads(capsys.readouterr().out)["vehicles"]
    assert np.float32(vehicle["worst_wind_m_s"]) == np.float32(results.metric("wind_max_m_s")[episode])
    expected = results.metric("tracking_error_rms_m")[episode]
    assert vehicle["tracking_error_rms_m"] == pytest.approx(expected, rel=1e-5)


@pytest.mark.long
def test_a_baseline_flies_what_qrsim_run_flies(tmp_path: Path) -> None:
    study = {
        "scenario": "search_and_rescue/2A",
        "policy": "baseline",
        "set": {"duration": 6.0, "world.persons": {"type": "lying", "fewest": 30, "most": 30, "found_distance": 60.0}},
        "vary": {"fleets.helicopters.vehicle.mass": {"values": [1.5, 1.7], "name": "mass"}},
        "metrics": ["persons_found", "found_share", "distance_m"],
        "failure": {"metric": "persons_found", "below": 1.0},
        "seeds": 2,
        "batch": 2,
    }
    data = opened(flown(tmp_path, **study))
    np.testing.assert_allclose(data["found_share"], data["persons_found"] / 30.0, rtol=1e-6)
    assert (data["distance_m"].values > 1.0).all()
    out = tmp_path / "run"
    words = ["run", "search_and_rescue/2A", "--policy", "baseline", "--seed", "1", "--no-figure", "--out", str(out)]
    settings = {**study["set"], "fleets.helicopters.vehicle.mass": 1.7}  # type: ignore[dict-item]
    assert main([*words, *(f"--set={path}={json.dumps(value)}" for path, value in settings.items())]) == 0
    run = qrsim.open_run(out)
    place = np.stack([run["truth"][f"position_ned.{axis}"][:, 0] for axis in "xyz"], axis=-1)
    length = np.linalg.norm(np.diff(place, axis=0), axis=-1).sum()
    assert length == pytest.approx(float(data["distance_m"].sel(mass=1.7, seed=1)), rel=1e-4)


@pytest.mark.long
@pytest.mark.parametrize("policy", ["mine.py:climb", {"pelicans": "mine.py:climb"}])
def test_a_policy_of_the_users_own_flies(tmp_path: Path, policy: Any) -> None:
    (tmp_path / "mine.py").write_text(
        "import qrsim\n\ndef climb(reading):\n    return qrsim.WaypointSetpoint.of([[0.0, 0.0, -12.0]])\n"
    )
    changes = {"policy": policy, "policy_ticks": 25, "vary": {MASS: {"values": [1.5, 1.6]}}, "seeds": 1}
    data = opened(flown(tmp_path, metrics=["end_error_m", "distance_m"], **changes))
    assert (data["end_error_m"].values > 0.05).all()


def test_the_command_line_says_what_would_be_flown(tmp_path: Path, capsys: Any) -> None:
    assert main(["sweep", str(write(tmp_path)), "--plan", "--json", "--out", str(tmp_path / "x.zarr")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["episodes"] == 60
    assert told["dimensions"] == {"wind": 3, "mass": 4, "seed": 5}
    assert not (tmp_path / "x.zarr").exists()
    assert main(["sweep", str(write(tmp_path)), "--workers", "2", "--scheduler", "tcp://here:1"]) == 2
    assert main(["sweep", str(write(tmp_path)), "--seeds", "0"]) == 2


SPEED = """
import jax.numpy as jnp

class Speed:
    numbers = {"speed_max_m_s": {"unit": "m/s", "doc": "largest speed", "over": "max"}}

    def init(self, world, state):
        return jnp.zeros_like(state.fleets[0].vehicle.position_ned.x)

    def update(self, memory, world, state, tick):
        return jnp.maximum(memory, state.fleets[0].vehicle.velocity_body.norm())

    def finish(self, memory, world, state):
        return {"speed_max_m_s": memory}

class Silent(Speed):
    numbers = {}

class Vague(Speed):
    numbers = {"speed_max_m_s": {"unit": "m/s", "doc": "largest speed", "over": "largest"}}

class Unkept(Speed):
    numbers = {"speed_min_m_s": {"unit": "m/s", "doc": "smallest speed", "over": "min"}}
"""


@pytest.mark.long
def test_metrics_of_the_users_own_are_kept(tmp_path: Path) -> None:
    (tmp_path / "speed.py").write_text(SPEED)
    own = {"own_metrics": "./speed.py:Speed", "failure": {"metric": "speed_max_m_s", "above": 1e-4}}
    path = flown(tmp_path, metrics=["distance_m", "speed_max_m_s"], **own)
    data = opened(path)
    assert data["speed_max_m_s"].attrs["units"] == "m/s"
    speed, distance = data["speed_max_m_s"].values, data["distance_m"].values
    results = Results(path)
    # Nobody flies farther than at his largest speed all the time.
    assert (speed > 0.0).all()
    assert (distance <= speed * results.scenario["duration"]).all()
    assert results.unit("speed_max_m_s") == "m/s"
    assert results.failed.all()


@pytest.mark.parametrize(
    ("name", "metric", "words"),
    [
        ("Silent", "speed_max_m_s", "does not declare its numbers; expected numbers = "),
        ("Vague", "speed_max_m_s", r"over: found 'largest'; allowed: mean, max, min, sum, rms over the vehicles"),
        ("Speed", "sped_max_m_s", r"no metric is called 'sped_max_m_s'; did you mean 'speed_max_m_s'\?"),
        ("Sped", "speed_max_m_s", r"'Sped'.*did you mean 'Speed'\?"),
    ],
)
def test_metrics_that_a_study_cannot_keep(tmp_path: Path, name: str, metric: str, words: str) -> None:
    (tmp_path / "speed.py").write_text(SPEED)
    with pytest.raises(UsageError, match=words):
        planned(tmp_path, metrics=[metric], own_metrics=f"./speed.py:{name}")


@pytest.mark.long
def test_a_number_that_is_promised_and_not_given_is_named(tmp_path: Path) -> None:
    (tmp_path / "speed.py").write_text(SPEED)
    with pytest.raises(RunError, match=r"finish does not return 'speed_min_m_s'; it returns"):
        flown(tmp_path, metrics=["speed_min_m_s"], own_metrics="./speed.py:Unkept")
