"""Policy files: what a policy sees and commands, what is read back, and what is refused."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim.errors import UsageError
from qrsim.tasks.learned import LearnedPolicy, PolicyFile, Scaling, View, forward, policy_of, read_policy

VIEW = View(
    task="hold",
    version=0,
    seconds=0.1,
    observed=("to_north", "to_east", "yaw"),
    acts=("pitch", "throttle", "battery"),
    kept=(0, 1),
    pairs=((0, 1),),
    yaw=2,
    flown=(0, 1),
    centre=(0.0, 0.25, 1.0),
    reach=(0.5, 0.25, 1.0),
)
# Two inputs of the goal and two of the last action; the outputs are the goal ahead and minus the goal to the right.
LAYERS = ((np.array([[1, 0], [0, -1], [0, 0], [0, 0]], np.float32), np.zeros(2, np.float32)),)

# One index where there must be two.
SHORT: Any = (0,)


def policy(**changes: Any) -> PolicyFile:
    parts = {"view": VIEW, "scaling": Scaling(np.zeros(4, np.float32), np.ones(4, np.float32)), "layers": LAYERS}
    return PolicyFile(**{**parts, **changes}, facts={"seed": 3})


def test_a_goal_is_seen_along_the_heading() -> None:
    # Heading east: a goal 2 m north is 2 m to the left, one 3 m east is 3 m ahead.
    seen = np.array([[2.0, 3.0, np.pi / 2]], np.float32)
    np.testing.assert_allclose(VIEW.features(seen, np.array([[0.5, 0.7]])), [[3.0, -2.0, 0.5, 0.7]], atol=1e-6)


def test_an_action_is_a_change_of_the_neutral_one_and_limited() -> None:
    np.testing.assert_allclose(VIEW.action(np.array([[1.0, -1.0], [9.0, 0.0]])), [[0.5, 0.0, 1.0], [1.0, 0.25, 1.0]])


def test_a_pursuer_sees_and_moves_relative_to_the_mouse() -> None:
    chasing = dataclasses.replace(
        VIEW, acts=("velocity_north", "velocity_east"), centre=(0.0, 0.0), reach=(1.0, 1.0), ahead=(0, 1), turned=(0, 1)
    )
    # A mouse 3 m north and 4 m east is 5 m ahead; 0.5 ahead and 0.1 to the right are 0.3 - 0.08 north, 0.4 + 0.06 east.
    seen, output = np.array([[3.0, 4.0, np.pi / 2]], np.float32), np.array([[0.5, 0.1]], np.float32)
    np.testing.assert_allclose(chasing.features(seen, output), [[5.0, 0.0, 0.5, 0.1]], atol=1e-6)
    np.testing.assert_allclose(chasing.action(output, seen), [[0.22, 0.46]], atol=1e-6)
    # One in the same place has no direction.
    np.testing.assert_array_equal(chasing.action(output, seen * 0.0), [[0.0, 0.0]])


def test_an_output_is_that_of_its_action() -> None:
    chasing = dataclasses.replace(
        VIEW, acts=("velocity_north", "velocity_east"), centre=(0.5, 0.0), reach=(1.0, 2.0), ahead=(0, 1), turned=(0, 1)
    )
    # 0.3 north and 0.4 east of a centre at 0.5 and 0, east in units of 2, towards 3 m north and 4 m east.
    seen = np.array([[3.0, 4.0, 0.0]], np.float32)
    found = chasing.output(np.array([[0.8, 0.8]], np.float32), seen)
    np.testing.assert_allclose(found, [[0.5, 0.0]], atol=1e-6)
    np.testing.assert_allclose(VIEW.output(np.array([[0.5, 0.0, 1.0]], np.float32), seen), [[1.0, -1.0]])


def test_an_integral_grows_and_turns_with_the_heading_and_is_limited() -> None:
    view = dataclasses.replace(VIEW, kept=(0, 1, 3, 4), pairs=((0, 1), (3, 4)), summed=(0, 1))
    assert (view.inputs, view.remembered) == (6, 4)
    seen = np.array([[2.0, 3.0, np.pi / 2]], np.float32)
    last = np.array([[0.5, 0.7, 4.0, 19.9]], np.float32)
    # Heading east: east is ahead, and north is to the left.
    np.testing.assert_allclose(view.features(seen, last), [[3.0, -2.0, 19.9, -4.0, 0.5, 0.7]], atol=1e-5)
    # 0.1 s of 2 m and of 3 m, the second at most 20 m s in all; outputs are limited to 10.
    after = view.remember(np.array([[0.1, -30.0]], np.float32), seen, last)
    np.testing.assert_allclose(after, [[0.1, -10.0, 4.2, 20.0]], atol=1e-5)


def test_files_with_and_without_integrals(tmp_path: Path) -> None:
    plain, path = policy(), tmp_path / "policy.npz"
    # Earlier versions wrote no integrals, and read files without.
    assert b"summed" not in plain.content()
    path.write_bytes(plain.content())
    assert read_policy(path).view == VIEW
    view = dataclasses.replace(VIEW, kept=(0, 3), pairs=(), summed=(0,))
    summing = policy(view=view)
    path.write_bytes(summing.content())
    assert read_policy(path).view == view
    for wrong in ({"kept": (0, 4)}, {"summed": (3,)}, {"summed": ()}):
        path.write_bytes(policy(view=dataclasses.replace(view, **wrong)).content())
        with pytest.raises(UsageError, match="is no policy that qrsim train has written, or it is damaged"):
            read_policy(path)


def test_a_network_by_hand() -> None:
    hidden = (np.array([[1.0], [2.0]], np.float32), np.array([0.5], np.float32))
    last = (np.array([[3.0]], np.float32), np.array([-1.0], np.float32))
    # 3 tanh(1 - 2 + 0.5) - 1 = 3 (-0.46212) - 1
    np.testing.assert_allclose(forward((hidden, last), np.array([[1.0, -1.0]])), [[-2.386352]], atol=1e-6)


def test_an_action_is_held_between_two_decisions() -> None:
    flown = LearnedPolicy(policy(), 1, 2)
    first = flown.act(np.array([[0.5, 0.0, 0.0]]))
    np.testing.assert_allclose(first, [[0.25, 0.25, 1.0]])
    np.testing.assert_array_equal(flown.act(np.array([[-1.0, 0.0, 0.0]])), first)
    np.testing.assert_allclose(flown.act(np.array([[-1.0, 0.0, 0.0]])), [[-0.5, 0.25, 1.0]])


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    path.write_bytes(policy().content())
    found = read_policy(path)
    assert (found.view, found.facts, found.name) == (VIEW, {"seed": 3}, str(path))
    np.testing.assert_array_equal(found.layers[0][0], LAYERS[0][0])
    # Equal policies are equal files.
    assert policy().content() == policy().content()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"layers": ()}, "is no policy"),
        ({"view": dataclasses.replace(VIEW, reach=("far", 0.25, 1.0))}, "is no policy"),
        ({"view": dataclasses.replace(VIEW, kept=(0, 9))}, "is no policy"),
        ({"view": dataclasses.replace(VIEW, turned=(0, 1))}, "is no policy"),
        ({"view": dataclasses.replace(VIEW, ahead=(0, 3))}, "is no policy"),
        ({"view": dataclasses.replace(VIEW, ahead=SHORT)}, "is no policy"),
        ({"view": dataclasses.replace(VIEW, ahead=(0, 1), turned=(0, 2))}, "is no policy"),
        ({"layers": ((LAYERS[0][0], np.zeros((2, 2), np.float32)),)}, "is no policy"),
        ({"layers": ((LAYERS[0][0][:3], LAYERS[0][1]),)}, "is no policy"),
        ({"layers": ((LAYERS[0][0] * np.float32(np.nan), LAYERS[0][1]),)}, "is no policy"),
        ({"scaling": Scaling(np.zeros(4, np.float32), np.zeros(4, np.float32))}, "is no policy"),
        ({"scaling": Scaling(np.zeros(3, np.float32), np.ones(3, np.float32))}, "is no policy"),
    ],
)
def test_parts_that_do_not_fit(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    path = tmp_path / "policy.npz"
    path.write_bytes(policy(**changes).content())
    with pytest.raises(UsageError, match=words):
        read_policy(path)


def test_files_that_are_no_policies(tmp_path: Path) -> None:
    path, content = tmp_path / "policy.npz", policy().content()
    for data in (b"", b"PK\x03\x04", content[: len(content) // 2], content[:-1], b"x" * 2000):
        path.write_bytes(data)
        with pytest.raises(UsageError, match=r"policy\.npz: is no NumPy archive of numbers, or it is damaged"):
            read_policy(path)
    np.savez(path, a=np.zeros(3))
    with pytest.raises(UsageError, match="is no policy that qrsim train has written"):
        read_policy(path)
    with pytest.raises(UsageError, match=r"cannot be read: No such file .* did you mean 'policy\.npz'"):
        read_policy(tmp_path / "polcy.npz")


def test_a_later_format_is_named() -> None:
    with np.load(io.BytesIO(policy().content())) as file:
        arrays = dict(file)
    meta = {**json.loads(arrays["meta"].tobytes()), "format": "qrsim policy 2"}
    arrays["meta"] = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    with pytest.raises(UsageError, match="its format is 'qrsim policy 2'; this qrsim reads 'qrsim policy 1'"):
        policy_of(arrays, "later.npz")
