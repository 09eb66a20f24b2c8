"""A learned policy as C: compiled by gcc, it acts as NumPy does."""

from __future__ import annotations

import ctypes
import dataclasses
import itertools
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim import cli
from qrsim.tasks.learned import PolicyFile, Scaling, View

# Two horizontal vectors that turn with the heading, one more input, and an action that is never given.
VIEW = View(
    task="made */ up",
    version=0,
    seconds=0.1,
    observed=("to_north", "to_east", "to_down", "yaw", "velocity_north", "velocity_east"),
    acts=("pitch", "roll", "battery", "throttle"),
    kept=(0, 1, 2, 4, 5),
    pairs=((0, 1), (4, 5)),
    yaw=3,
    flown=(0, 1, 3),
    centre=(0.0, 0.0, 1.0, 0.2),
    reach=(0.3, 0.3, 1.0, 0.2),
)
PLAIN = dataclasses.replace(VIEW, pairs=(), yaw=None)
# Turned towards an offset, and two of the outputs turned back.
CHASING = dataclasses.replace(VIEW, pairs=((0, 1), (4, 5)), yaw=None, ahead=(0, 1), turned=(2, 0))
# The integrals of one vector, which turns too, and of one more number.
SUMMING = dataclasses.replace(VIEW, kept=(0, 1, 4, 5, 6, 7, 8), pairs=((0, 1), (4, 5), (6, 7)), summed=(0, 1, 2))


def policy(view: View) -> PolicyFile:
    rng = np.random.default_rng(5)
    sizes = [view.inputs, 32, 7, len(view.flown)]
    layers = tuple(
        (
            (rng.normal(size=pair) / np.sqrt(pair[0])).astype(np.float32),
            rng.normal(0.0, 0.1, pair[1]).astype(np.float32),
        )
        for pair in itertools.pairwise(sizes)
    )
    mean, deviation = rng.normal(size=view.inputs), rng.uniform(0.5, 2.0, view.inputs)
    return PolicyFile(view, Scaling(mean.astype(np.float32), deviation.astype(np.float32)), layers, {})


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
@pytest.mark.parametrize("view", [VIEW, PLAIN, CHASING, SUMMING], ids=["turning", "plain", "chasing", "summing"])
def test_c_acts_as_numpy_does(view: View, tmp_path: Path) -> None:
    file = policy(view)
    (tmp_path / "policy.npz").write_bytes(file.content())
    assert cli.main(["export", str(tmp_path / "policy.npz"), "--format", "c"]) == 0
    words = ["gcc", "-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-O2", "-shared", "-fPIC"]
    subprocess.run([*words, "-o", tmp_path / "policy.so", tmp_path / "policy.c", "-lm"], check=True)
    fly = ctypes.CDLL(str(tmp_path / "policy.so")).qrsim_policy
    pilot, last, rng = file.pilot(1, 0.1), np.zeros(view.remembered, np.float32), np.random.default_rng(6)
    for scale in (1.0, 3.0, 3.0, 100.0):
        seen = rng.normal(0.0, scale, (1, 6)).astype(np.float32)
        action = np.zeros(4, np.float32)
        pointers: list[Any] = [
            each.ctypes.data_as(ctypes.POINTER(ctypes.c_float)) for each in (seen[0].copy(), last, action)
        ]
        fly(*pointers)
        np.testing.assert_allclose(action, pilot.act(seen)[0], rtol=0.0, atol=1e-6)
    # The last one is no trivial action, and the battery keeps its value.
    assert action[2] == 1.0
    assert 0.0 < abs(action[0]) <= 1.0


def test_what_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("policy.npz").write_bytes(policy(VIEW).content())
    Path("policy.c").write_text("mine")
    Path("cut.npz").write_bytes(policy(VIEW).content()[:-40])
    for words, said in (
        (["policy.npz", "--format", "csv"], "policy.npz is a policy, not a run; allowed: --format c or onnx"),
        (["policy.npz", "--format", "c"], "policy.c exists; choose another --out, or --force to overwrite it"),
        (["policy.npz", "--format", "c", "--every", "2"], "--every: a policy has no ticks and no streams"),
        (["cut.npz", "--format", "c"], "policy cut.npz: is no NumPy archive of numbers, or it is damaged"),
        ([".", "--format", "c"], ". is a folder; --format c needs a policy file, such as policy.npz"),
        ([".", "--format", "onnx"], ". is a folder; --format onnx needs a policy file, such as policy.npz"),
        (["none.npz", "--format", "c"], "none.npz: cannot be read: No such file or directory"),
    ):
        assert cli.main(["export", *words]) == 2
        shown = capsys.readouterr().err
        assert said in shown
        assert shown.count("\n") == 1
    assert Path("policy.c").read_text() == "mine"
