"""Tasks as environments: Gymnasium, PettingZoo, and pure functions of JAX. Importing this registers them.

``gymnasium.make("qrsim/keep_spot-v0")``, ``gymnasium.make_vec("qrsim/keep_spot-v0", num_envs=1024)``,
``qrsim.envs.parallel_env("cats_and_mouse/1C")``, ``qrsim.envs.Functional.of("keep_spot")``.
It may import ``runs`` and the layers below it.
Read ``functional.py`` first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from qrsim.envs.arguments import checked_arguments
from qrsim.envs.functional import Functional
from qrsim.extras import require

if TYPE_CHECKING:
    from qrsim.envs.parallel import ParallelTask
    from qrsim.envs.vector_parallel import VectorParallelTask

# Scenarios with one vehicle to command, and with several.
SINGLE = (
    "keep_spot",
    "goto_waypoint",
    "keep_velocity",
    "land_on_pad",
    "search_small",
    "search_and_rescue/2A",
    "search_and_rescue/2B",
    "plume_mapping/3A",
    "plume_mapping/3B",
    "plume_mapping/3C",
    "plume_mapping/3E",
    "plume_mapping/3F",
)
SEVERAL = (
    "keep_spot_10",
    "keep_formation",
    "cats_and_mouse/1A",
    "cats_and_mouse/1B",
    "cats_and_mouse/1C",
    "search_and_rescue/2C",
    "search_and_rescue/2D",
    "plume_mapping/3D",
    "plume_mapping/3G",
)

# Those that are registered in the form that learners like too (``learner.py``).
LEARNED = ("keep_spot", "goto_waypoint", "keep_velocity", "land_on_pad")

# Of all tasks; a change of what they observe, command or reward raises it.
VERSION = 0

# Of any scenario with a task: gymnasium.make(ANY_TASK, scenario="my_task.yaml").
ANY_TASK = f"qrsim/task-v{VERSION}"

__all__ = [
    "ANY_TASK",
    "LEARNED",
    "SEVERAL",
    "SINGLE",
    "VERSION",
    "Functional",
    "gymnasium_id",
    "learner_id",
    "parallel_env",
    "register",
    "vector_parallel_env",
]


def gymnasium_id(scenario: str) -> str:
    """Return the Gymnasium id of a built-in scenario's environment, such as "qrsim/keep_spot-v0"."""
    return f"qrsim/{scenario.replace('/', '_')}-v{VERSION}"


def learner_id(scenario: str) -> str:
    """Return the Gymnasium id of a scenario in the form for learners, such as "qrsim/keep_spot-learner-v0"."""
    return f"qrsim/{scenario.replace('/', '_')}-learner-v{VERSION}"


def register() -> None:
    """Register each single-vehicle task as an environment of Gymnasium, if it is installed."""
    try:
        import gymnasium
    except ModuleNotFoundError:
        return
    known = {gymnasium_id(scenario): {"scenario": scenario} for scenario in SINGLE}
    for name, options in {**known, ANY_TASK: {}}.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="qrsim.envs.single:SingleTask",
                vector_entry_point="qrsim.envs.vector:VectorTask",
                kwargs=options,
            )
    for scenario in LEARNED:
        if learner_id(scenario) not in gymnasium.registry:
            entry = "qrsim.envs.learner:LearnerTask"
            gymnasium.register(learner_id(scenario), entry_point=entry, kwargs={"scenario": scenario})


@checked_arguments
def parallel_env(scenario: Any, **options: Any) -> ParallelTask:
    """Return the PettingZoo environment of a scenario; see ``ParallelTask``.

    Raises:
        MissingExtraError: PettingZoo is not installed.
    """
    require("envs", "an environment of PettingZoo")
    from qrsim.envs.parallel import ParallelTask

    return ParallelTask(scenario, **options)


@checked_arguments
def vector_parallel_env(scenario: Any, num_envs: int = 1, **options: Any) -> VectorParallelTask:
    """Return ``num_envs`` PettingZoo environments of a scenario in one batch; see ``VectorParallelTask``.

    Raises:
        MissingExtraError: Gymnasium is not installed.
    """
    require("envs", "environments of PettingZoo")
    from qrsim.envs.vector_parallel import VectorParallelTask

    return VectorParallelTask(scenario, num_envs, **options)


register()
