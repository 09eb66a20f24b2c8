"""What a user meets first: names that complete, names mistyped, rollouts by name, set-points that look down."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.errors import UsageError
from qrsim.interface.actions import ActionChecker

STILL: dict[str, Any] = {
    "name": "still",
    "duration": 0.4,
    "fleets": {
        "a": {"controller": {"type": "waypoint", "feed": "truth"}, "vehicles": [{"position_ned": [0, 0, -5]}]},
    },
}


def test_completion_shows_what_is_for_users_and_no_more() -> None:
    names = {name for name in dir(qrsim) if not name.startswith("__")}
    rooms = {"contracts", "discover", "envs", "geoid", "identify", "slam", "sweep", "validate"}
    assert names == set(qrsim.__all__) - {"__version__"} | rooms
    assert {"Simulation", "rollout", "make_world", "load", "slam"} <= names
    assert not names & {"Any", "Iterable", "Path", "TYPE_CHECKING", "metadata", "annotations"}
    assert all(getattr(qrsim, name) is not None for name in names)


def test_type_checkers_completion_and_the_package_have_the_same_names() -> None:
    """What is imported for type checkers comes from where it is found when it is used."""
    tree = ast.parse(Path(qrsim.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
    named = {alias.name: node.module for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert named == qrsim._LAZY
    assert set(named) == set(qrsim.__all__) - {"load", "__version__"}


def test_a_mistyped_name_is_told_the_nearest_one() -> None:
    with pytest.raises(
        AttributeError, match=r"^module 'qrsim' has no attribute 'Simulaton'; did you mean 'Simulation'\?$"
    ):
        _ = qrsim.Simulaton
    with pytest.raises(AttributeError, match=r"^module 'qrsim' has no attribute 'xyzzy'$"):
        _ = qrsim.xyzzy


def test_a_rollout_takes_a_name_a_path_a_dict_or_a_scenario(tmp_path: Path) -> None:
    """All are the same flight, as long as the scenario unless it is said."""
    scenario = qrsim.load_scenario(STILL)
    path = tmp_path / "still.yaml"
    path.write_text(scenario.to_yaml(), encoding="utf-8")
    flown = [qrsim.rollout(source, seed=2)["position_ned"] for source in (STILL, path, str(path), scenario)]
    flown += [qrsim.rollout(scenario.world(), ticks=20, seed=2)["position_ned"]]
    flown += [qrsim.rollout([STILL, scenario.world()], seeds=[2, 2])["position_ned"][1:]]
    for other in flown[1:]:
        np.testing.assert_array_equal(other, flown[0])
    wide = qrsim.rollout(STILL, ticks=5, worlds=2, overrides=["fleets.a.vehicles.0.position_ned=[0,0,-7]"])
    np.testing.assert_allclose(wide["position_ned"][:, 0, 2], -7.0, atol=0.01)


@pytest.mark.parametrize(
    ("source", "options", "message"),
    [
        ("hovver", {}, "hovver.*did you mean 'hover'"),
        (3, {}, "world: expected a scenario .its name, path or content. or a World, found 3"),
        ("hover", {"precision": "float16"}, "precision"),
        ("hover", {"overrides": ["world.windd=calm"]}, "windd"),
    ],
)
def test_what_is_no_world_is_refused(source: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        qrsim.rollout(source, **options)


def test_overrides_from_a_generator_hold_for_every_scenario() -> None:
    lower = (f"fleets.a.vehicles.0.position_ned.2={z}" for z in (-7,))
    flown = qrsim.rollout([STILL, STILL], seeds=[1, 2], ticks=5, overrides=lower)
    np.testing.assert_allclose(flown["position_ned"][:, 0, 2], -7.0, atol=0.01)


def test_a_world_has_no_duration_and_no_overrides() -> None:
    world = qrsim.load_scenario(STILL).world()
    with pytest.raises(UsageError, match="ticks: how many is not said, and a World has no duration"):
        qrsim.rollout(world)
    with pytest.raises(UsageError, match="overrides: they are of scenarios, and a World is given"):
        qrsim.rollout(world, ticks=1, overrides=["duration=1"])


def test_a_set_point_below_the_ground_is_told_that_z_is_down() -> None:
    checker = ActionChecker(qrsim.make_world([[0, 0, -5]], controller="velocity_height"), np.dtype(np.float32))
    (fine,) = checker.actions(qrsim.VelocityHeightSetpoint.of([[1.0, 0.0]], -12.0))
    assert float(fine.z[0]) == -12.0  # type: ignore[union-attr]
    with pytest.raises(UsageError, match=r"z of vehicle 0 .*is 12, below the ground; z is down: -12 is 12 m up"):
        checker.actions(qrsim.VelocityHeightSetpoint.of([[1.0, 0.0]], 12.0))
    with pytest.raises(UsageError, match="z is down"):
        checker.actions({"vehicles": qrsim.VelocityHeightSetpoint.of([[1.0, 0.0]], 0.5)})


def test_citation_and_changes_are_of_the_version_that_pyproject_states() -> None:
    root = Path(qrsim.__file__).resolve().parents[2]
    version = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert f"\nversion: {version}\n" in (root / "CITATION.cff").read_text(encoding="utf-8")
    released = re.findall(r"^## \[(\d[^\]]*)\]", (root / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert released[0] == version
