"""The curve of a training for TensorBoard: event files in its folder, written by tensorboardX."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from qrsim.extras import load
from qrsim.studies.learn.training import Tried


class Board:
    """Event files of a training; the numbers of ``Tried`` over the decisions of all agents.

    Args:
        folder: of the training.
        steps: decisions so far; TensorBoard drops later points of older files, which a resumed training repeats.

    Raises:
        MissingExtraError: tensorboardX is not installed.
    """

    def __init__(self, folder: Path, steps: int):
        module: Any = load("tensorboard", "--tensorboard", "tensorboardX")
        self._writer = module.SummaryWriter(str(folder), purge_step=steps + 1)

    def add(self, row: Tried) -> None:
        """Write a row of the training curve to TensorBoard's file."""
        for name, value in asdict(row).items():
            if name not in ("cycle", "steps"):
                self._writer.add_scalar(f"training/{name}", value, row.steps)
        self._writer.flush()

    def close(self) -> None:
        """Close TensorBoard's file."""
        self._writer.close()
