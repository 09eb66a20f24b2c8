"""Pages of the components: every type that a scenario can name, with its parameters."""

from __future__ import annotations

from collections.abc import Mapping

from tools.reference.schema import Kind, Node, bounds_of, choices_of, is_each, kinds, parameters
from tools.reference.tables import code, number, page, sentence, table

# Page, title, and the places whose components it holds; the first that a place begins with.
PAGES: dict[str, tuple[str, tuple[str, ...]]] = {
    "components/sensors": ("Components: sensors", ("fleets.NAME.sensors",)),
    "components/vehicles": (
        "Components: vehicles, batteries, starts",
        ("fleets.NAME.vehicle", "fleets.NAME.battery", "fleets.NAME.placement"),
    ),
    "components/control": ("Components: controllers, guidance, estimators", ("fleets.NAME",)),
    "components/world": ("Components: air, ground, sky, obstacles", ("world",)),
    "components/tasks": ("Components: tasks", ("task",)),
}
SHARED = """Angles in `_rad` may be given as `_deg` instead. A parameter marked "list" takes one number
for all vehicles of the fleet, or a list with one for each."""
# Parameters that every sensor has, and one page says once.
FITTED = ("delay", "jitter", "mount_position_body", "mount_attitude_rad")


def page_of(kind: Kind) -> str:
    """Return the page, without its ending, that holds a kind."""
    for name, (_, places) in PAGES.items():
        if any(
            kind.place == place or kind.place.startswith((f"{place}.", f"{place}s", f"{place}[")) for place in places
        ):
            return name
    raise LookupError(f"no page for components of {kind.place}")


def anchor(kind: Kind, name: str = "") -> str:
    """Return the anchor of a kind's heading, or of one of its types."""
    return f"{kind.name} {name}".strip().replace(" ", "-")


def pages() -> Mapping[str, str]:
    """Return the pages of all components, and one that lists them."""
    made = {}
    for name, (title, _) in PAGES.items():
        own = [kind for kind in kinds() if page_of(kind) == name]
        places = ", ".join(f"`{kind.place}`" for kind in own)
        introduction = f"The types that {places} can have, with the parameters of each. {SHARED}"
        made[f"{name}.md"] = page(title, introduction, *(_kind(kind) for kind in own))
    rows = [
        (f"[{kind.name}]({page_of(kind)}.md#{anchor(kind)})", code(kind.place), code(kind.default), _types(kind))
        for kind in kinds()
    ]
    introduction = """A scenario is made of components: a wind, a vehicle, a sensor. Each key below takes one of
        the types in its row, as in `wind: {type: log_shear, speed_20ft: 6}`. Every type has defaults for most
        of its parameters. [Your own components](../howto/own_component.md) work the same way."""
    made["components.md"] = page("Components", introduction, table(("kind", "key", "default", "types"), rows))
    return made


def _types(kind: Kind) -> str:
    return ", ".join(f"[`{name}`]({page_of(kind)}.md#{anchor(kind, name)})" for name in kind.types)


def _kind(kind: Kind) -> str:
    about = sentence(kind.about).rstrip(".")
    usual = f" Default: `{kind.default}`." if kind.default else ""
    head = f"## {kind.name}\n\n`{kind.place}`: {about}.{usual}"
    fitted = f"\n\n{_fitted(kind)}" if kind.name == "sensors" else ""
    return head + fitted + "".join(f"\n\n{_type(kind, name, node)}" for name, node in kind.types.items())


def _fitted(kind: Kind) -> str:
    """Return the parameters that all sensors have."""
    (node, *_) = (node for node in kind.types.values() if all(name in node["properties"] for name in FITTED))
    rows = [row for row in _rows(node) if row[0].strip("`") in FITTED]
    return f"All sensors have these parameters as well, unless their own table says otherwise:\n\n{table(HEAD, rows)}"


def _type(kind: Kind, name: str, node: Node) -> str:
    title = f"### {kind.name}: {name}" if kind.name != name else f"### {name} {name}"
    about = sentence(node.get("description", "")).strip()
    rows = [row for row in _rows(node) if kind.name != "sensors" or row[0].strip("`") not in FITTED]
    parts = [title, about, table(HEAD, rows) if rows else "It has no parameters."]
    return "\n\n".join(part for part in parts if part)


HEAD = ("parameter", "default", "unit", "allowed", "meaning")


def _rows(node: Node) -> list[tuple[str, ...]]:
    rows = []
    for name, inner, required in parameters(node):
        default = "required" if required else code(number(inner["default"])) if "default" in inner else ""
        unit = inner.get("unit", "")
        allowed = ", ".join(
            part for part in (bounds_of(inner), choices_of(inner), "list" if is_each(inner) else "") if part
        )
        rows.append((code(name), default, "" if unit == "1" else unit, allowed, sentence(inner.get("description", ""))))
    return rows
