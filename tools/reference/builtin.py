"""The page of the scenarios and studies that come with qrsim."""

from __future__ import annotations

from collections.abc import Mapping

from qrsim.scenarios.scenario import built_in_names, load_scenario
from qrsim.studies.sweep.study import built_in_studies, load_study
from tools.reference.tables import code, number, page, table


def pages() -> Mapping[str, str]:
    """Return the page."""
    introduction = """These scenarios and studies are part of the package. Their names can be used wherever a
        scenario or a study is asked for: `qrsim run NAME`, `qrsim.load("NAME")`, `qrsim sweep NAME`, and `extends:
        NAME` in a scenario of your own. `qrsim show NAME` prints one with every default filled in."""
    scenarios = table(
        ("scenario", "vehicles", "time [s]", "vehicle types", "air", "task", "content"),
        map(_scenario, built_in_names()),
    )
    studies = table(("study", "scenario", "seeds", "content"), map(_study, built_in_studies()))
    return {
        "builtin.md": page(
            "Built-in scenarios and studies", introduction, "## Scenarios", scenarios, "## Studies", studies
        )
    }


def _scenario(name: str) -> tuple[str, ...]:
    spec = load_scenario(name).spec
    fleets = spec.fleets.values()
    types = dict.fromkeys(fleet.vehicle.type for fleet in fleets)
    task = "" if spec.task.type == "none" else code(spec.task.type)
    air = [each.type for each in (spec.world.wind, spec.world.turbulence) if each.type not in ("calm", "still")]
    count = sum(len(fleet.vehicles) for fleet in fleets)
    about = (", ".join(map(code, types)), ", ".join(map(code, air)), task)
    return code(name), str(count), number(spec.duration), *about, spec.description


def _study(name: str) -> tuple[str, ...]:
    spec = load_study(name).spec
    scenario = code(spec.scenario) if isinstance(spec.scenario, str) else "its own"
    return code(name), scenario, str(spec.seeds), spec.description
