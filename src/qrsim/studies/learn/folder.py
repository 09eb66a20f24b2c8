"""The folder of a training: the best policy, the curve, and checkpoints to go on from."""

from __future__ import annotations

import csv
import io
import json
import os
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import jax
import numpy as np

from qrsim.errors import UsageError, did_you_mean, os_error_as
from qrsim.files.atomic import write_atomically
from qrsim.files.numpy_file import read_arrays
from qrsim.files.user_files import read_bytes
from qrsim.studies.learn.ppo import Learner
from qrsim.studies.learn.training import Training, Tried
from qrsim.tasks.learned import policy_of

POLICY, CURVE = "policy.npz", "curve.csv"
CHECKPOINT, BEFORE = "checkpoint.npz", "checkpoint_before.npz"
FORMAT = "qrsim checkpoint 1"
LARGEST, MOST_NUMBERS = 2**28, 32_000_000
META, BEST = "checkpoint", "best"


def make_folder(folder: Path) -> None:
    """Create the folder of a training; raise UsageError if it cannot be used.

    Raises:
        UsageError: it cannot be made, or nothing can be written into it.
    """
    with os_error_as(UsageError, f"{folder}: cannot be written"):
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / ".writable", b"")
        (folder / ".writable").unlink()


def save(training: Training, folder: Path) -> None:
    """Write the best policy, the training curve and a checkpoint to a folder, keeping the previous checkpoint.

    Raises:
        UsageError: the folder cannot be written.
    """
    save_policy(training, folder)
    with os_error_as(UsageError, f"{folder}: cannot be written"):
        write_atomically(folder / CURVE, curve_text(training.curve).encode())
        if (folder / CHECKPOINT).exists():
            os.replace(folder / CHECKPOINT, folder / BEFORE)
        write_atomically(folder / CHECKPOINT, _content(training))


def save_policy(training: Training, folder: Path) -> None:
    """Write the best policy so far to a training's folder.

    Raises:
        UsageError: the folder cannot be written.
    """
    with os_error_as(UsageError, f"{folder}: cannot be written"):
        if training.best is not None:
            write_atomically(folder / POLICY, training.best[0].content())


def curve_text(curve: list[Tried]) -> str:
    """Return a training curve as CSV with a header."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow([field.name for field in fields(Tried)])
    rows.writerows([getattr(row, field.name) for field in fields(Tried)] for row in curve)
    return text.getvalue()


def restore(training: Training, folder: Path) -> str:
    """Set a training to the last checkpoint in its folder, or the one before if damaged; return a note on it.

    Returns:
        A warning if the last one is damaged, else "".

    Raises:
        UsageError: there is no checkpoint that can be read, or it is of another training.
    """
    warning = ""
    for name in (CHECKPOINT, BEFORE):
        path = folder / name
        if not path.exists():
            continue
        try:
            arrays, meta = _read(path)
        except UsageError as error:
            warning = f"{error}; the training goes on from {BEFORE}"
            continue
        _check_plan(meta["plan"], _plan_of(training), folder)
        _take(training, arrays, meta, path)
        return warning
    raise UsageError(warning.partition(";")[0] or f"--resume: {folder} has no {CHECKPOINT}{_nearest_folder(folder)}")


def _content(training: Training) -> bytes:
    """Return the bytes of a checkpoint of the present state of a training."""
    meta = {
        "format": FORMAT,
        "plan": _plan_of(training),
        "cycle": training.cycle,
        "steps": training.steps,
        "curve": [asdict(row) for row in training.curve],
        "best": None if training.best is None else asdict(training.best[1]),
    }
    arrays: dict[str, Any] = {META: np.frombuffer(json.dumps(meta).encode(), np.uint8)}
    arrays |= {f"learner_{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(training.learner))}
    arrays |= {f"averaged_{i}": leaf for i, leaf in enumerate(jax.tree.leaves(training.averaged))}
    moments = training.moments
    arrays |= {"count": np.array(moments.count), "mean": moments.mean, "squares": moments.squares}
    arrays |= training.flights.objective.state()
    if training.best is not None:
        arrays[BEST] = np.frombuffer(training.best[0].content(), np.uint8)
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the arrays and the metadata of a checkpoint file.

    Raises:
        UsageError: it cannot be read, or is none.
    """
    with os_error_as(UsageError, f"{path}: cannot be read"):
        data = read_bytes(path, LARGEST)
    arrays = read_arrays(str(path), data, MOST_NUMBERS)
    try:
        meta = json.loads(arrays[META].tobytes().decode())
        if meta["format"] != FORMAT:
            raise ValueError
        return arrays, {name: meta[name] for name in ("plan", "cycle", "steps", "curve", "best")}
    except (KeyError, TypeError, ValueError):
        raise UsageError(f"{path}: is no checkpoint that this qrsim train has written") from None


def _take(training: Training, arrays: dict[str, Any], meta: dict[str, Any], path: Path) -> None:
    """Set the state of a training to that of a checkpoint; ``meta``: its data other than arrays.

    Raises:
        UsageError: parts do not fit.
    """
    leaves, structure = jax.tree.flatten(training.learner)
    try:
        found = [arrays[f"learner_{i}"] for i in range(len(leaves))]
        if any(new.shape != old.shape or new.dtype != old.dtype for new, old in zip(found, leaves, strict=True)):
            raise ValueError
        training.curve = [Tried(**row) for row in meta["curve"]]
        training.moments.count = float(arrays["count"])
        training.moments.mean, training.moments.squares = arrays["mean"], arrays["squares"]
        training.flights.objective.restore(arrays)
        training.cycle, training.steps = int(meta["cycle"]), int(meta["steps"])
        if meta["best"] is not None:
            policy = policy_of(read_arrays(str(path), arrays[BEST].tobytes(), MOST_NUMBERS), str(path))
            training.best = policy, Tried(**meta["best"])
    except (KeyError, TypeError, ValueError):
        raise UsageError(f"{path}: its parts do not fit this training") from None
    training.averaged = _averaged_of(training, arrays, path)
    learner = jax.tree.unflatten(structure, [jax.numpy.asarray(leaf) for leaf in found])
    training.learner = Learner(*learner)


def _averaged_of(training: Training, arrays: dict[str, Any], path: Path) -> Any:
    """Return the running mean of policy weights in a checkpoint; None if the training does not average.

    Raises:
        UsageError: parts do not fit.
    """
    if not training.plan.settings.averaged:
        return None
    leaves, structure = jax.tree.flatten(training.learner.weights["policy"])
    found = [arrays.get(f"averaged_{i}", np.zeros(0)) for i in range(len(leaves))]
    if any(new.shape != old.shape or new.dtype != np.float32 for new, old in zip(found, leaves, strict=True)):
        raise UsageError(f"{path}: its parts do not fit this training")
    return jax.tree.unflatten(structure, found)


def _plan_of(training: Training) -> dict[str, Any]:
    """Return those settings of a training that a resumed one must share."""
    plan = training.plan
    return {
        "task": f"{training.view.task} (version {training.view.version})",
        "set": list(plan.overrides),
        "shorter": list(plan.shorter),
        "seed": plan.seed,
        "envs": plan.envs,
        "tries": plan.tries,
        "settings": asdict(plan.settings),
        "early": plan.early,
        "starts": plan.starts,
        "integral": plan.integral,
        "start": plan.start,
        "fleet": plan.fleet,
        "others": plan.others,
    }


def _check_plan(kept: dict[str, Any], wanted: dict[str, Any], folder: Path) -> None:
    """Raise UsageError if the settings ``kept`` in a checkpoint differ from those of this training (``wanted``).

    Raises:
        UsageError: a value differs.
    """
    # Checkpoints of earlier versions had no integral and no starts.
    kept = {"integral": False, "starts": 0} | kept
    for name, value in wanted.items():
        if kept.get(name) != value:
            raise UsageError(f"--resume: the training in {folder} has {name} {kept.get(name)}; this one has {value}")


def _nearest_folder(folder: Path) -> str:
    """Return a "did you mean" hint with the most similar folder name; "" if none is similar."""
    parent = folder.parent
    return (
        did_you_mean(folder.name, [each.name for each in parent.iterdir() if each.is_dir()]) if parent.is_dir() else ""
    )
