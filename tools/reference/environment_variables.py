"""The page of environment variables; a test compares the names with those in the source."""

from __future__ import annotations

from collections.abc import Mapping

from tools.reference.tables import code, page, table

PUBLIC = (
    (
        "QRSIM_CACHE_DIR",
        "`qrsim` in the user's cache folder",
        "Folder of compiled programs and of tables of the sky among obstacles.",
    ),
    ("QRSIM_COMPILATION_CACHE", "on", "`off`: compiled programs are neither read from the cache nor kept there."),
    (
        "QRSIM_COMPILER",
        "`llvm`",
        "`xla`: programs are compiled by XLA, not by the compiler of qrsim. Results agree within rounding.",
    ),
    (
        "QRSIM_DATA_DIR",
        "`qrsim/recordings` in the user's cache folder",
        "Folder of the public recordings that `qrsim data fetch` downloads.",
    ),
    (
        "QRSIM_TIER",
        "`auto`",
        "`quick`: machine code that compiles fast and flies more slowly; `better`: the opposite, at once.",
    ),
)
INTERNAL = (
    ("QRSIM_LOCKSTEP_FD", "Set for the firmware of an autopilot: number of the socket that its clock is stepped over."),
    ("QRSIM_LOCKSTEP_FREE", "Set for the firmware of an autopilot: its clock runs freely."),
    ("QRSIM_PEERS", "Benchmarks: folder of the environments that other simulators are installed into."),
)


def pages() -> Mapping[str, str]:
    """Return the page."""
    introduction = """qrsim reads these variables of its environment. They choose folders and compilers, and
        change nothing in a scenario. [Compiled programs](../howto/cache.md) explains those of the cache."""
    public = table(("variable", "default", "effect"), ((code(name), default, text) for name, default, text in PUBLIC))
    internal = table(("variable", "use"), ((code(name), text) for name, text in INTERNAL))
    return {
        "environment_variables.md": page(
            "Environment variables",
            introduction,
            "## For users",
            public,
            "## Internal",
            "qrsim sets or reads these itself.",
            internal,
        )
    }
