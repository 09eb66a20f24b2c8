"""``qrsim check``: how often it goes wrong, with which seeds, when and where; and that these seeds do it again."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import scipy
from tests.small_worlds import bare_pair

from qrsim import cli
from qrsim.runs import open_run
from qrsim.scenarios.making import make_scenario

RUNS, FIRST = 16, 10
# Two vehicles on noisy sensors beside a southern edge; the second loses its receiver for a while.
PARTS: dict[str, Any] = {
    "name": "near_the_edge",
    "duration": 5.0,
    "area": {"type": "box", "x_min": -1.0, "x_max": 60.0, "y_min": -60.0, "y_max": 60.0, "z_min": -40.0},
    "wind": {"type": "log_shear", "speed_20ft": 1.5, "wind_from_deg": 0.0},
    "turbulence": "dryden_first_order",
    "sky": {"errors": {"type": "ou", "std": 1.0}},
    "sensors": {"gnss": "gnss_receiver", "height": "barometer", "attitude": "attitude_estimator"},
    "controller": "waypoint",
    "faults": [{"sensor": "gnss", "kind": "lost", "start": 3.0, "end": 4.0, "vehicles": ["steady"]}],
    "vehicles": [
        {"position_ned": [0.0, 0.0, -10.0], "name": "bold"},
        {"position_ned": [30.0, 0.0, -10.0], "name": "steady"},
    ],
}


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("check") / "near_the_edge.yaml"
    file.write_text(make_scenario(**PARTS).to_yaml())
    return file


@pytest.fixture(scope="module")
def check(scenario: Path) -> Callable[..., int]:
    """Run a check in this process, where JAX has started with one device."""

    def run(*words: str) -> int:
        return cli.main(["check", str(scenario), "--seeds", str(RUNS), "--first-seed", str(FIRST), *words])

    return run


@pytest.fixture(scope="module")
def found(check: Callable[..., int], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The result as JSON, with a picture."""
    import contextlib
    import io

    picture, out = tmp_path_factory.mktemp("picture") / "worst.png", io.StringIO()
    with contextlib.redirect_stdout(out):
        assert check("--json", "--out", str(picture)) == 1
    return json.loads(out.getvalue())


def by_name(found: dict[str, Any], name: str) -> dict[str, Any]:
    return next(outcome for outcome in found["outcomes"] if outcome["name"] == name)


class TestResult:
    def test_counts_and_intervals(self, found):
        """Some of the runs leave the area and some do not; the interval is the exact one, of the beta distribution."""
        assert (found["scenario"], found["runs"], found["first_seed"]) == ("near_the_edge", RUNS, FIRST)
        assert found["duration_s"] == 5.0
        leaves = by_name(found, "leaves the area")
        assert 0 < leaves["runs"] < RUNS
        for outcome in found["outcomes"]:
            runs = outcome["runs"]
            assert outcome["fraction"] == runs / RUNS
            low = scipy.stats.beta.ppf(0.025, runs, RUNS - runs + 1) if runs else 0.0
            high = scipy.stats.beta.ppf(0.975, runs + 1, RUNS - runs) if runs < RUNS else 1.0
            assert (outcome["low"], outcome["high"]) == pytest.approx((low, high), abs=1e-9)
            assert len(outcome["seeds"]) == runs
            assert set(outcome["seeds"]) <= set(range(FIRST, FIRST + RUNS))
            assert (outcome["worst"] is None) == (runs == 0)

    def test_what_happens_in_every_run_and_in_none(self, found):
        lost = by_name(found, "loses GNSS")
        assert lost["runs"] == RUNS
        assert lost["worst"]["vehicle"] == "steady"
        assert lost["worst"]["time_s"] == pytest.approx(3.0)
        assert lost["worst"]["seed"] == FIRST
        for name in ("collides", "runs out of battery", "is not finite"):
            assert by_name(found, name)["runs"] == 0
        assert found["outcomes"][-1]["name"] == "any of these"
        assert found["outcomes"][-1]["runs"] == RUNS

    def test_the_earliest_comes_first(self, found):
        leaves, some = by_name(found, "leaves the area"), found["outcomes"][-1]
        assert leaves["worst"]["seed"] == leaves["seeds"][0]
        assert leaves["worst"]["vehicle"] == "bold"
        assert some["worst"]["time_s"] == min(leaves["worst"]["time_s"], 3.0)

    def test_margins(self, found):
        margins = found["margins"]
        edge, apart = margins["nearest to the edge of the area"], margins["nearest to another vehicle"]
        assert edge["vehicle"] == "bold"
        assert 0.0 <= edge["value"] < 0.2
        assert edge["position_ned"][0] == pytest.approx(-1.0 + edge["value"], abs=1e-4)
        assert 20.0 < apart["value"] < 30.5
        assert margins["strongest wind"]["unit"] == "m/s"
        assert 1.5 < margins["strongest wind"]["value"] < 5.0
        assert margins["farthest from its leg"]["value"] > 1.0

    def test_a_picture_is_written(self, found):
        assert Path(found["picture"]).read_bytes().startswith(b"\x89PNG")

    def test_seeds_do_it_again(self, found, scenario, tmp_path, capsys):
        """The run of the first that leaves the area stops at the same time and place; that of one that stays stays."""
        leaves = by_name(found, "leaves the area")
        fine = next(seed for seed in range(FIRST, FIRST + RUNS) if seed not in leaves["seeds"])
        for seed in (leaves["seeds"][0], fine):
            folder = tmp_path / str(seed)
            words = ["--seed", str(seed), "--out", str(folder), "--no-figure"]
            assert cli.main(["run", str(scenario), *words]) == 0
            run = open_run(folder)
            stops = [event for event in run.events if event.kind == "out_of_area"]
            assert bool(stops) == (seed != fine)
            if stops:
                worst = leaves["worst"]
                assert (stops[0].vehicle, stops[0].time) == (
                    worst["vehicle"],
                    pytest.approx(worst["time_s"], abs=0.021),
                )
                last = run["truth"].arrays([f"position_ned.{axis}" for axis in "xyz"])
                place = [float(values[-1, 0]) for values in last.values()]
                assert place == pytest.approx(worst["position_ned"], abs=0.02)
        capsys.readouterr()


class TestTable:
    def test_says_what_and_how_to_look_at_it(self, check, found, scenario, capsys):
        assert check("--set", "duration=5.0") == 1
        printed = capsys.readouterr().out
        assert printed.startswith(f"near_the_edge: {RUNS} runs of 5 s, 2 vehicles\n")
        leaves = by_name(found, "leaves the area")
        row = next(line for line in printed.splitlines() if "leaves the area" in line)
        assert row.split()[3:5] == [str(leaves["runs"]), f"{100 * leaves['fraction']:.1f}"]
        interval = re.search(r"([\d.]+) to +([\d.]+) %", row)
        assert interval is not None
        assert [float(x) for x in interval.groups()] == pytest.approx(
            [100 * leaves["low"], 100 * leaves["high"]], abs=0.05
        )
        assert f"first: seed {leaves['seeds'][0]}, bold, {leaves['worst']['time_s']:.2f} s" in printed
        assert f"and {RUNS - 6} more" in printed
        assert "nearest to the edge of the area" in printed
        again = next(line for line in printed.splitlines() if line.startswith("to fly the first failed run")).partition(
            ": "
        )[2]
        first = found["outcomes"][-1]["seeds"][0]
        assert shlex.split(again) == ["qrsim", "run", str(scenario), "--seed", str(first), "--set", "duration=5.0"]

    def test_policies_are_part_of_how_to_look_at_it(self, check, scenario, tmp_path, capsys):
        """And a command that nobody can hold makes every run go wrong."""
        policy = tmp_path / "falling.py"
        policy.write_text(
            "import numpy as np\n\ndef fall(reading):\n    return np.tile([0, 0, 0.1, 0, 12.0], (2, 1))\n"
        )
        words = ["--policy", f"{policy}:fall", "--policy-ticks", "10", "--duration", "4"]
        assert check(*words) == 1
        printed = capsys.readouterr().out
        row = next(line for line in printed.splitlines() if "any of these" in line)
        assert "100.0 %" in row
        again = next(line for line in printed.splitlines() if line.startswith("to fly the first failed run")).partition(
            ": "
        )[2]
        assert shlex.split(again)[5:] == ["--duration", "4", "--policy", f"{policy}:fall", "--policy-ticks", "10"]

    def test_where_all_goes_well(self, tmp_path, capsys):
        """Exit code 0, and an upper bound all the same."""
        file = tmp_path / "fine.yaml"
        file.write_text(bare_pair().to_yaml())
        assert cli.main(["check", str(file), "--seeds", "3", "--duration", "1"]) == 0
        printed = capsys.readouterr().out
        row = next(line for line in printed.splitlines() if "any of these" in line)
        assert re.search(rf" 0 +0.0 % +0.0 to +{100 * scipy.stats.beta.ppf(0.975, 1, 3):.1f} %", row)
        assert "to fly the first failed run" not in printed

    @pytest.mark.long
    def test_a_mission_that_no_run_finishes(self, tmp_path, capsys):
        file = tmp_path / "short.yaml"
        legs = "[{to_ned: [90, 0, -20]}, {to_ned: [0, 0, -20]}]"
        file.write_text(
            "name: short\nduration: 1.0\nfleets: {one: {vehicle: multirotor, sensors: ideal, vehicles: "
            f"[{{position_ned: [0, 0, -20], legs: {legs}}}]}}}}\n"
        )
        assert cli.main(["check", str(file), "--seeds", "2"]) == 1
        printed = capsys.readouterr().out
        assert "\nno run finished its mission in 1 s; a longer --duration may be enough\n" in printed


class TestBadInput:
    @pytest.mark.parametrize(
        ("words", "parts"),
        [
            (["keep_spit"], ["no scenario is called 'keep_spit'", "keep_spot"]),
            (["keep_spot", "--seeds", "0"], ["--seeds 0: expected a positive number of runs"]),
            (["keep_spot", "--first-seed", "-1"], ["--first-seed -1"]),
            (["keep_spot", "--first-seed", str(2**63 - 100)], ["2**63 - 1 - --seeds"]),
            (["keep_spot", "--duration", "-3"], ["--duration -3: expected a positive number of seconds"]),
            (["keep_spot", "--set", "world.wnd=calm"], ["world.wnd", "did you mean 'wind'"]),
            (["keep_spot", "--out", "worst.gif"], ["'gif' is no picture", "png"]),
            (["keep_spot", "--cores", "0"], ["--cores 0: expected a positive number"]),
            (["keep_spot", "--policy-ticks", "5"], ["--policy-ticks 5: there is no --policy"]),
            (["keep_spot", "--policy", "nowhere.py:fly"], ["there is no file nowhere.py"]),
            (["keep_spot", "--policy", "math:sqrt", "--policy-ticks", "0"], ["policy_ticks: 0"]),
            (["keep_spot", "--estimator", "math:pi"], ["estimator: expected a function of a reading", "3.14"]),
        ],
    )
    def test_refused(self, refused, words: list[str], parts: list[str]):
        refused(["check", *words], *parts)

    def test_a_picture_needs_a_folder(self, refused, tmp_path):
        refused(["check", "keep_spot", "--out", str(tmp_path / "none" / "worst.png")], "there is no folder", code=1)

    def test_numbers_are_not_lost_with_the_picture(self, check, tmp_path, capsys, monkeypatch):
        def full(path: Path, data: bytes) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("qrsim.runs.picture.write_atomically", full)
        assert check("--out", str(tmp_path / "worst.svg")) == 1
        printed = capsys.readouterr()
        assert "leaves the area" in printed.out
        assert "picture:" not in printed.out
        assert printed.err.count("error: ") == 1
        assert "No space left on device" in printed.err
