"""The worked example of a task of one's own, in everything that takes a scenario, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test

from qrsim import cli
from qrsim.envs import ANY_TASK, Functional, parallel_env
from qrsim.envs.batch import Batch
from qrsim.envs.scoring import maker, play_policy
from qrsim.errors import UsageError
from qrsim.scenarios.scenario import load_scenario

EXAMPLE = Path(__file__).parents[2] / "examples" / "formation"
SCENARIO = str(EXAMPLE / "formation.yaml")
SHORT = ["duration=2"]
ONE = [*SHORT, "fleets.followers.vehicles=[{position_ned: [-8, 8, -30]}]"]

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


class TestForms:
    @pytest.mark.long
    def test_one_follower_is_an_environment_of_gymnasium(self) -> None:
        env = gymnasium.make(ANY_TASK, scenario=SCENARIO, overrides=ONE)
        check_env(env.unwrapped, skip_render_check=True)
        seen, _ = env.reset(seed=3)
        assert seen["see"].shape == (11,)
        # Eight metres behind the leader and to the right of it.
        assert seen["see"][9:].tolist() == [-8.0, 8.0]
        many = gymnasium.make_vec(ANY_TASK, num_envs=2, scenario=SCENARIO, overrides=ONE)
        seen_by_all, _ = many.reset(seed=3)
        np.testing.assert_array_equal(seen_by_all["see"][0], seen["see"])
        action = {"act": np.zeros((2, 2), np.float32), "say": np.zeros((2, 6), np.float32)}
        _, rewards, *_ = many.step(action)
        _, reward, *_ = env.step({"act": np.zeros(2, np.float32), "say": np.zeros(6, np.float32)})
        assert rewards[0] == pytest.approx(reward, rel=1e-4)
        with pytest.raises(UsageError, match="formation: 3 vehicles are commanded, followers_0, followers_1"):
            gymnasium.make(ANY_TASK, scenario=SCENARIO)

    @pytest.mark.long
    def test_several_are_one_of_pettingzoo(self) -> None:
        team = parallel_env(SCENARIO, overrides=SHORT)
        parallel_api_test(team, num_cycles=12)
        team.reset(seed=1)
        nothing = {agent: {"act": np.zeros(2, np.float32)} for agent in team.agents}
        for _ in range(3):
            seen, *_ = team.step(nothing)
        # The leader is vehicle 0 of the world, at height 30 m, and the followers hear where it says it is.
        for agent in team.agents:
            slot = seen[agent]["sender"].tolist().index(0)
            np.testing.assert_allclose(seen[agent]["heard"][slot, :3], [0.0, 0.0, -30.0], atol=3.0)

    @pytest.mark.nightly
    def test_and_pure_functions(self) -> None:
        env = Functional.of(SCENARIO, [*ONE, "world.turbulence=still"])
        episodes, seen = jax.jit(jax.vmap(env.reset))(jnp.arange(2, dtype=jnp.uint32))
        assert seen["see"].shape == (2, 1, 11)
        _, step = jax.jit(jax.vmap(env.step))(episodes, jnp.zeros((2, 1, 2)))
        # Nobody is far from its place after a step of ten.
        assert (np.asarray(step.reward) > -0.002).all()
        assert (np.asarray(step.reward) <= 0.0).all()


@pytest.mark.long
def test_the_reward_is_the_squared_distance_from_the_place() -> None:
    """Two follow a leader that waits, in still air; the first begins a quarter of the spacing off its place."""
    calm = [
        "world.wind=calm",
        "world.turbulence=still",
        "ranges=[]",
        "fleets.leader.vehicles=[{position_ned: [0, 0, -30]}]",
    ]
    starts = "fleets.followers.vehicles=[{position_ned: [-8, 10, -30]}, {position_ned: [-8, -8, -30]}]"
    batch = Batch(SCENARIO, 1, [*SHORT, *calm, starts])
    batch.reset([1])
    rewards = []
    for _ in range(10):
        reward, *_ = batch.step(np.zeros((1, 2, 2)))
        rewards.append(reward[0])
    # Of ten steps; (2/8)^2 = 0.0625. They drift by decimetres in the first of these steps.
    assert rewards[0][0] == pytest.approx(-0.0625 / 10, rel=0.1)
    assert -0.0002 < rewards[0][1] <= 0.0


class TestCommands:
    @pytest.mark.long
    def test_score(self, capsys: pytest.CaptureFixture[str]) -> None:
        """The baseline leaves hovering far behind, which loses the leader, 3 m/s fast, within seconds."""
        assert cli.main(["score", SCENARIO, "--seeds", "2", "--set", "duration=8", "--json"]) == 0
        baseline, hover = json.loads(capsys.readouterr().out)["policies"]
        assert (baseline["policy"], hover["policy"]) == ("baseline", "hover")
        assert -0.1 < baseline["mean"] < 0.0
        assert -1.0 < hover["mean"] < -0.3
        assert baseline["flown_to_the_end"] == 1.0

    @pytest.mark.long
    def test_run_by_the_baseline_and_without(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        flown = []
        for name, more in (("kept", ["--policy", "baseline"]), ("left", [])):
            out = ["--out", str(tmp_path / name), "--no-figure", "--json", "--duration", "12"]
            assert cli.main(["run", SCENARIO, *out, *more]) == 0
            flown.append([row["distance_m"] for row in json.loads(capsys.readouterr().out)["vehicles"]])
        # The leader flies some 3 m/s; who is told nothing stays.
        assert min(flown[0][1:]) > 25.0
        assert max(flown[1][1:]) < 12.0

    @pytest.mark.nightly
    def test_check_and_sweep(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert cli.main(["check", SCENARIO, "--seeds", "2", "--duration", "1"]) == 0
        study = tmp_path / "spacing.yaml"
        study.write_text(
            f"name: spacing\ndescription: apart\nscenario: {SCENARIO}\npolicy: baseline\nset: {{duration: 2.0}}\n"
            "vary:\n  task.spacing: {values: [6.0, 9.0], name: spacing, unit: m}\nseeds: 1\nmetrics: [distance_m]\n"
        )
        assert cli.main(["sweep", str(study), "--workers", "1", "--out", str(tmp_path / "out.zarr")]) == 0
        assert "2 flown" in capsys.readouterr().out


def changed(folder: Path, old: str, new: str) -> str:
    """Write the example with a text changed in its class or scenario, and return the scenario."""
    for name in ("formation.py", "formation.yaml"):
        text = (EXAMPLE / name).read_text(encoding="utf-8")
        (folder / name).write_text(text.replace(old, new), encoding="utf-8")
    written = "".join((folder / name).read_text(encoding="utf-8") for name in ("formation.py", "formation.yaml"))
    assert new in written
    return str(folder / "formation.yaml")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("def judge", "def juge", r"lacks the method judge\(memory, .* that a task has; did you mean that by 'juge'\?"),
        ("spacing: 8.0", "spacin: 8.0", r"task.spacin: no such parameter of '.*'; did you mean 'spacing'\?"),
        ("py:Formation", "py:Formatio", r"formation.py has no 'Formatio'; did you mean 'Formation'\?"),
        ("./formation.py:", "./formatio.py:", r"there is no file .*; did you mean '.*formation.py'\?"),
        ("self.places(world)], axis", "], axis", r"the observation has 9 numbers, but Formation.sees names 11"),
        (
            "believed(fleet_of(world, state, self.fleet)[1])",
            "(lambda all: all[all[:, 0] > 0])(believed(fleet_of(world, state, self.fleet)[1]))",
            r"Formation.observe: it cannot be compiled, because an array that is picked by a mask has no known length",
        ),
        ("self.fleet, qrsim.VelocityHeightSetpoint", "self.fleet, dict", "TypeError"),
        (
            "only(world, self.fleet, qrsim.VelocityHeightSetpoint(north, east, memory, jnp.zeros_like(north)))",
            "only(world, self.fleet, {'north': north})",
            r"Formation.commands: the action of fleet 'followers' is dict; expected a kind .*VelocityHeightSetpoint, ",
        ),
        (
            "VelocityHeightSetpoint(north,",
            "VelocityHeightSetpoint(north[:2],",
            r"fleet 'followers': VelocityHeightSetpoint.velocity_north has shape \(2,\); expected \(3,\)",
        ),
        ("asks_for = qrsim.VelocityHeightSetpoint", "asks_for = int", "asks for, int; no controller does"),
        (
            "baseline = Keeper",
            "baseline = dict",
            r"Formation.baseline is <class 'dict'>; expected a class with act\(seen\)",
        ),
        ('setting("leader"', 'setting("leadr"', "no fleet is called 'leadr'; did you mean 'leader'"),
    ],
)
def test_what_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(UsageError, match=message) as raised:
        load_scenario(changed(tmp_path, old, new))
    assert len(str(raised.value).splitlines()) == 2


class TestSpeaking:
    @pytest.mark.long
    def test_a_policy_of_score_may_speak(self) -> None:
        """Who says where it is not is believed by nobody else; the third row says nothing and sends its beacon."""
        heard: list[Any] = []

        def speak(seen: Any) -> Any:
            heard.append(seen)
            say = np.full((3, 6), np.nan)
            say[0], say[1] = 7.0, -7.0
            return {"act": np.zeros((3, 2)), "say": say}

        batch = Batch(SCENARIO, 1, SHORT)
        play_policy(batch, "own", maker(speak, batch.functional.play), np.array([0]))
        # To the third follower, number 3 of the world: of numbers 1 and 2.
        last = heard[-1]
        rows = {int(who): row for row, who in enumerate(last["sender"][2])}
        assert last["heard"][2, rows[1]].tolist() == [7.0] * 6
        assert last["heard"][2, rows[2]].tolist() == [-7.0] * 6
        rows = {int(who): row for row, who in enumerate(last["sender"][0])}
        np.testing.assert_allclose(last["heard"][0, rows[3], :3], [-16.0, 16.0, -30.0], atol=3.0)

    @pytest.mark.long
    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"act": np.zeros((3, 2)), "sya": 1}, "policy own: there is no part 'sya'; did you mean 'say'"),
            ({"say": np.zeros((3, 6))}, "policy own: expected a dict of act and say; act is missing"),
            ({"act": np.zeros((3, 2)), "say": np.zeros((3, 5))}, r"say: expected shape \(3, 6\) .*, found \(3, 5\)"),
            (
                {"act": np.zeros((3, 2)), "say": "hello"},
                r"policy own: say: expected numbers of shape \(3, 6\), found 'hello'",
            ),
            ({"act": np.zeros(2), "say": np.zeros((3, 6))}, r"policy own: expected actions of shape \(3, 2\)"),
        ],
    )
    def test_what_is_refused(self, given: Any, message: str) -> None:
        batch = Batch(SCENARIO, 1, SHORT)
        with pytest.raises(UsageError, match=message):
            play_policy(batch, "own", maker(lambda seen: given, batch.functional.play), np.array([0]))


@pytest.mark.long
def test_a_baseline_that_fails_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = changed(tmp_path, "own, place = ", "own, plac = ")
    assert cli.main(["score", scenario, "--seeds", "1", "--set", "duration=1"]) == 1
    assert capsys.readouterr().err == "error: policy baseline: step 1: NameError: name 'place' is not defined\n"
