"""Records: frozen, trees for JAX, with the metadata of their fields."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import FieldInfo, cast, field_info, parameter, quantity, record, replace, select, setting, walk
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import UsageError


@record
class Wind:
    """A component with one field of each kind."""

    speed: Any = parameter(
        default=2.0, unit="m/s", doc="mean speed", minimum=0.0, maximum=40.0, inherits="world.wind.speed"
    )
    tau: Any = parameter(unit="s", doc="time constant", above=0.0, default=3.0)
    mode: str = setting(default="still", doc="which")
    direction: Any = quantity(default=None, doc="where it blows")


@record
class Reading:
    """Nested records, some of whose leaves have a unit of their own."""

    velocity: Vec3 = quantity(unit="m/s", doc="over ground")
    attitude: Euler = quantity(unit="deg", doc="estimate")
    valid: Any = quantity()
    period: float = setting(default=0.2, unit="s", doc="between readings")


@record
class Chip:
    """A component with presets."""

    preset: str = setting(default="good", doc="which")
    noise: Any = parameter(default=1.0, unit="m", doc="std")
    rate: float = setting(default=50.0, unit="Hz", doc="of samples")
    bias: Any = parameter(default=0.5, unit="m", doc="in no preset")
    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "good": {"noise": 1.0, "rate": 50.0},
        "poor": {"noise": 3.0, "rate": 10.0},
    }


@record
class OwnChip(Chip):
    """One that a user has derived, with another preset where none is given."""

    preset: str = setting(default="poor", doc="which")


def reading() -> Reading:
    axis = jnp.zeros(2, jnp.float32)
    return Reading(Vec3(axis, axis, axis), Euler(axis, axis, axis), jnp.ones(2, bool))


class TestPresets:
    def test_what_is_not_given_is_that_of_the_preset(self):
        assert (Chip().noise, Chip().rate) == (1.0, 50.0)
        poor = Chip(preset="poor")
        assert (poor.preset, poor.noise, poor.rate, poor.bias) == ("poor", 3.0, 10.0, 0.5)
        assert (Chip("poor").noise, OwnChip().rate) == (3.0, 10.0)

    def test_what_is_given_counts_instead(self):
        # Also where it is the number of the default preset.
        assert (Chip(preset="poor", noise=1.0).noise, Chip(preset="poor", noise=1.0).rate) == (1.0, 10.0)
        assert (Chip("poor", 1.0).noise, Chip("poor", 1.0, 50.0).rate) == (1.0, 50.0)

    def test_a_tree_comes_back_with_its_own_numbers(self):
        doubled = jax.tree.map(lambda leaf: 2.0 * leaf, Chip("poor"))
        assert (doubled.noise, doubled.rate, doubled.bias) == (6.0, 10.0, 1.0)
        assert (replace(doubled, rate=7.0).noise, replace(doubled, rate=7.0).rate) == (6.0, 7.0)

    def test_there_is_no_other(self):
        with pytest.raises(UsageError, match="Chip: no preset is called 'por'; did you mean 'poor'"):
            Chip(preset="por")
        with pytest.raises(UsageError, match="Chip: no preset is called 3; known: good, poor"):
            Chip(preset=3)  # type: ignore[arg-type]


class TestRecord:
    def test_is_frozen(self):
        with pytest.raises(dataclasses.FrozenInstanceError):
            Wind().speed = 3.0  # type: ignore[misc]

    def test_required_fields_are_required(self):
        with pytest.raises(TypeError, match="velocity"):
            Reading()  # type: ignore[call-arg]

    def test_only_numbers_are_leaves(self):
        assert jax.tree.leaves(Wind(speed=1.0, tau=2.0, mode="gusty")) == [1.0, 2.0]

    def test_a_tree_comes_back_as_its_record(self):
        wind = jax.tree.map(lambda leaf: 2.0 * leaf, Wind(mode="gusty"))
        assert wind == Wind(4.0, 6.0, "gusty")

    def test_a_new_number_compiles_nothing_and_a_new_setting_does(self):
        traces = []

        @jax.jit
        def speed(wind: Wind) -> Any:
            traces.append(wind.mode)
            return wind.speed * (2.0 if wind.mode == "gusty" else 1.0)

        assert [float(speed(Wind(v))) for v in (1.0, 2.0, 3.0)] == [1.0, 2.0, 3.0]
        assert traces == ["still"]
        assert float(speed(Wind(1.0, mode="gusty"))) == 2.0
        assert traces == ["still", "gusty"]

    def test_vmap_over_a_parameter(self):
        sweep = replace(Wind(), speed=jnp.arange(3.0), tau=jnp.ones(3))
        np.testing.assert_array_equal(jax.vmap(lambda w: w.speed + w.tau)(sweep), [1.0, 2.0, 3.0])

    def test_gradient_is_a_record(self):
        gradient = jax.grad(lambda w: w.speed**2 * w.tau)(Wind())
        assert isinstance(gradient, Wind)
        assert (float(gradient.speed), float(gradient.tau), gradient.mode) == (12.0, 4.0, "still")

    def test_replace_leaves_the_original(self):
        wind = Wind()
        assert replace(wind, speed=9.0) == Wind(9.0)
        assert wind == Wind()


class TestFieldInfo:
    def test_parameter(self):
        speed, tau = (field_info(f) for f in dataclasses.fields(Wind)[:2])
        assert speed == FieldInfo("m/s", "mean speed", 0.0, 40.0, None, False, "world.wind.speed")
        assert (tau.above, tau.minimum, tau.static, tau.inherits) == (0.0, None, False, None)

    def test_setting_and_quantity(self):
        mode, direction = (field_info(f) for f in dataclasses.fields(Wind)[2:])
        assert (mode.static, mode.doc, mode.unit) == (True, "which", "")
        assert direction == FieldInfo(doc="where it blows")

    def test_a_plain_field_has_no_metadata(self):
        @dataclasses.dataclass
        class Plain:
            x: float = 0.0

        assert field_info(dataclasses.fields(Plain)[0]) == FieldInfo()


class TestCast:
    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_floats_take_the_type_and_nothing_else_does(self, dtype: Any):
        given = {"python": 1.5, "array": np.ones(2, np.float32), "int": 3, "ids": np.arange(2, dtype=np.uint32)}
        given |= {"flag": True, "double": np.ones(2)}
        found = cast(given, dtype)
        assert {name: found[name].dtype for name in ("python", "array", "double")} == dict.fromkeys(
            ("python", "array", "double"), np.dtype(dtype)
        )
        assert found["ids"].dtype == np.uint32
        assert found["flag"].dtype == bool
        assert np.issubdtype(found["int"].dtype, np.integer)
        assert float(found["python"]) == 1.5

    def test_a_record_keeps_its_settings(self):
        wind = cast(Wind(1.0, 2.0, "gusty"), np.float32)
        assert wind.mode == "gusty"
        assert (wind.speed.dtype, wind.speed.shape) == (np.dtype(np.float32), ())

    def test_double_precision_is_not_lost_on_the_way(self):
        assert float(cast(Wind(0.1), np.float64).speed) == 0.1


def test_select_chooses_vehicle_by_vehicle():
    yes, no = reading(), jax.tree.map(lambda leaf: ~leaf if leaf.dtype == bool else leaf + 1.0, reading())
    chosen = select(jnp.asarray([True, False]), yes, no)
    np.testing.assert_array_equal(chosen.velocity.y, [0.0, 1.0])
    np.testing.assert_array_equal(chosen.valid, [True, False])
    assert chosen.period == 0.2


class TestWalk:
    def test_names_leaves_and_inherited_units(self):
        item = reading()
        found = list(walk(item))
        assert [(name, info.unit) for name, _, info in found] == [
            ("velocity.x", "m/s"),
            ("velocity.y", "m/s"),
            ("velocity.z", "m/s"),
            # A leaf's own unit stands.
            ("attitude.roll", "rad"),
            ("attitude.pitch", "rad"),
            ("attitude.yaw", "rad"),
            ("valid", ""),
        ]
        assert found[0][1] is item.velocity.x
        assert found[0][2].doc.startswith("first axis")

    def test_settings_are_not_walked(self):
        assert [name for name, _, _ in walk(Wind())] == ["speed", "tau"]
        assert [name for name, _, _ in walk(Wind(direction=1.0))] == ["speed", "tau", "direction"]

    def test_prefix_and_depth(self):
        @record
        class Outer:
            inner: Reading = quantity(unit="unused")

        names = [name for name, _, _ in walk(Outer(reading()), "fleet.")]
        assert names[0] == "fleet.inner.velocity.x"
        units = {name: info.unit for name, _, info in walk(Outer(reading()))}
        assert units["inner.velocity.x"] == "m/s"
        assert units["inner.valid"] == "unused"

    def test_matches_the_order_of_the_leaves(self):
        item = reading()
        assert [leaf is walked for leaf, (_, walked, _) in zip(jax.tree.leaves(item), walk(item), strict=True)] == [
            True
        ] * 7


@pytest.mark.long
def test_records_that_differ_only_in_their_type_are_others_to_jax() -> None:
    """A hundred classes of one form, each compiled on its own; JAX itself takes one in ten for another."""

    def made(factor: int) -> type:
        @record
        class Own:
            number: float = parameter(1.0, unit="1", doc="a number")

            def value(self) -> Any:
                return self.number * factor

        return Own

    kinds, compiled = [made(factor) for factor in range(100)], jax.jit(lambda item: item.value())
    assert [float(compiled(kind(2.0))) for kind in kinds] == [2.0 * factor for factor in range(100)]
    structures = [jax.tree.structure(kind(2.0)) for kind in kinds]
    assert all(structures[0] != other for other in structures[1:])


def test_a_record_tells_the_path_of_its_leaves() -> None:
    @record
    class Outer:
        part: Any = quantity(doc="a part")
        other: float = parameter(3.0, unit="1", doc="a number")
        option: str = setting("a", doc="an option")

    leaves, structure = jax.tree_util.tree_flatten_with_path(Outer(part={"k": 1.0}))
    assert [(jax.tree_util.keystr(path), leaf) for path, leaf in leaves] == [(".part['k']", 1.0), (".other", 3.0)]
    again = jax.tree.unflatten(structure, [5.0, 6.0])
    assert (again.part, again.other, again.option) == ({"k": 5.0}, 6.0, "a")
    assert structure != jax.tree.structure(Outer(part={"k": 1.0}, option="b"))
