"""``qrsim list``, ``qrsim show`` and ``qrsim schema``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import tyro

from qrsim.apps import Repeated


@dataclass(frozen=True)
class List:
    """List the scenarios that come with qrsim, or the components that a scenario can name.

    Example:
      qrsim list
      qrsim list --json
      qrsim list --components
    """

    components: bool = False
    """List components of every kind instead: built-in ones and those of installed packages."""
    json: bool = False
    """Print JSON: name, description, duration and number of vehicles; for components kind, name, class and origin."""

    def run(self) -> None:
        """Run ``qrsim list``: print a line for each scenario or component."""
        if self.components:
            self._components()
            return
        from qrsim.scenarios.scenario import built_in_names, load_scenario

        rows = []
        for name in built_in_names():
            spec = load_scenario(name).spec
            vehicles = sum(len(fleet.vehicles) for fleet in spec.fleets.values())
            rows.append(
                {"name": name, "vehicles": vehicles, "duration_s": spec.duration, "description": spec.description}
            )
        if self.json:
            import json

            print(json.dumps(rows, indent=2))
            return
        width = max(len(str(row["name"])) for row in rows)
        for row in rows:
            counts = f"{row['vehicles']:>3} vehicles  {row['duration_s']:>6g} s"
            print(f"{row['name']:<{width}}  {counts}  {row['description']}")

    def _components(self) -> None:
        """Print the components that scenarios can name, and where each comes from."""
        from qrsim.scenarios.registry import components

        rows = components()
        if self.json:
            import json

            print(json.dumps(rows, indent=2))
            return
        kinds, names = (max(len(row[key]) for row in rows) for key in ("kind", "name"))
        for row in rows:
            print(f"{row['kind']:<{kinds}}  {row['name']:<{names}}  {row['from']}")


@dataclass(frozen=True)
class Show:
    """Print a scenario with every default filled in, as YAML that can be saved and changed.

    Comments at the end give derived values: hover throttle, thrust over weight and the steady airspeed that each fleet
    holds. The first one gives the site's heights above the ellipsoid and above mean sea level. The last ones give, for
    each leg of a plan, its item with its line in the file, and what of the plan is skipped.

    Example:
      qrsim show outdoor_patrol > mine.yaml
      qrsim show my_scenario.yaml --set world.wind.speed_20ft=7
      qrsim show hover --program steps
      qrsim show outdoor_patrol --wind wind.png
    """

    scenario: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SCENARIO")] = "outdoor_patrol"
    """Name (see 'qrsim list') or YAML file."""
    set: Annotated[Repeated, tyro.conf.arg(metavar="PATH=VALUE")] = field(default_factory=list)
    """Change one value of the scenario; can be given several times."""
    json: bool = False
    """Print JSON instead, without derived values unless --derived is given."""
    derived: bool = False
    """Print only the values derived from the parameters of each fleet's vehicles."""
    wind: Annotated[str | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Draw the mean wind over height into this picture (.png, .pdf, .svg) instead."""
    program: Annotated[str | None, tyro.conf.arg(metavar="FORM", help_behavior_hint="(default: none)")] = None
    """Print the compiled program of a tick instead: its graph of operations ('graph'), the loops that compute them in
    their order ('steps'), or the text that LLVM compiles ('llvm')."""

    def run(self) -> None:
        """Run ``qrsim show``: print the resolved scenario and quantities derived from its vehicles."""
        import json

        from qrsim.scenarios.derived import derived_of, heights_line
        from qrsim.scenarios.plan_lines import plan_lines
        from qrsim.scenarios.scenario import load_scenario
        from qrsim.scenarios.weather_lines import profile_lines
        from qrsim.scenarios.wind_limits import envelope_lines

        scenario = load_scenario(self.scenario, self.set)
        if self.program is not None:
            from qrsim.simulation.showing import program_text

            print(program_text(scenario.world(), self.program))
            return
        if self.wind is not None:
            from pathlib import Path

            from qrsim.runs.wind_figure import save_wind_picture

            save_wind_picture(scenario, Path(self.wind))
            print(f"picture: {self.wind}")
            return
        derived = derived_of(scenario)
        if self.json:
            print(json.dumps(derived, indent=2) if self.derived else scenario.spec.model_dump_json(indent=2))
            return
        if not self.derived:
            print(scenario.to_yaml().rstrip())
        # Comments of YAML, so that what is printed can be saved and flown.
        mark = "" if self.derived else "# "
        print(f"{mark}{heights_line(scenario)}")
        for line in profile_lines(scenario.spec):
            print(f"{mark}{line}")
        for fleet, numbers in derived.items():
            print(f"{mark}Derived values of fleet '{fleet}':")
            for name, value in numbers.items():
                print(f"{mark}  {name}: {value:.4g}")
        for line in (*envelope_lines(scenario.spec), *plan_lines(scenario.planned)):
            print(f"{mark}{line}")


@dataclass(frozen=True)
class Schema:
    """Print the JSON schema of scenario files, for editors and other programs.

    Example:
      qrsim schema > scenario.schema.json
    """

    def run(self) -> None:
        """Run ``qrsim schema``: print the JSON schema of scenario files."""
        import json

        from qrsim.scenarios.scenario import json_schema

        print(json.dumps(json_schema(), indent=2))
