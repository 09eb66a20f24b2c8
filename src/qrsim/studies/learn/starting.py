"""Policies that a training starts with: what a plan's ``start`` names."""

from __future__ import annotations

from qrsim.errors import UsageError
from qrsim.tasks.baselines import baseline
from qrsim.tasks.learned import PolicyFile, View, read_policy
from qrsim.tasks.play import Play

# The start that imitates the task's baseline.
BASELINE = "baseline"


def read_start(start: str | None, play: Play, view: View, width: int) -> PolicyFile | None:
    """Return the policy file that a training starts with; None for another start, which is possible then.

    Args:
        start: ``BASELINE``, the name of a policy file, or None for nothing.
        play: the task and its world.
        view: of the learner.
        width: of the two hidden layers of its network.

    Raises:
        UsageError: there is no such file or baseline, or it is of another task, version or size.
    """
    if start is None:
        return None
    if start == BASELINE:
        baseline(play)
        return None
    found = read_policy(start)
    found.maker(play, view.task, view.version)
    sizes, wanted = [layer[0].shape for layer in found.layers], [(view.inputs, width), (width, width)]
    wanted.append((width, len(view.flown)))
    if sizes != wanted:
        its, ours = (", ".join(f"{rows} x {columns}" for rows, columns in each) for each in (sizes, wanted))
        raise UsageError(f"--start {start}: its layers are {its}; this training's are {ours}")
    if found.view != view:
        raise UsageError(f"--start {start}: it scales its actions, or decides, in another way than this training")
    return found
