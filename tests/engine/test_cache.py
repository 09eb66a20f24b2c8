"""The cache of programs: made once, made anew where it cannot be trusted, never a traceback."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import stat
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxprs_in_params

import qrsim
from qrsim.core.noise import Key
from qrsim.core.structure import from_plain, to_plain
from qrsim.core.tree import quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.engine import by_llvm, cache, folders, programs
from qrsim.engine.layout import Packer, struct
from qrsim.engine.llvm import Binary
from qrsim.interface.actions import ActionChecker
from qrsim.world import tick as ticks_of
from qrsim.world.draws import keys_of

HEAD = len(cache.MAGIC) + 32


def binary(code: bytes = b"\x7fELF code", scratch: int = 64) -> Binary:
    return Binary(code, scratch)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, of which nothing was said before."""
    monkeypatch.setattr(cache, "folder", lambda: tmp_path / "native")
    folders._warn.cache_clear()
    cache._tidied.cache_clear()
    return tmp_path / "native"


def signed(header: dict[str, Any], code: bytes) -> bytes:
    """A file with a right digest."""
    text = json.dumps(header).encode()
    content = len(text).to_bytes(4, "little") + text + code
    return cache.MAGIC + hashlib.sha256(content).digest() + content


def opened(path: Path) -> tuple[dict[str, Any], bytes]:
    content = path.read_bytes()[HEAD:]
    end = 4 + int.from_bytes(content[:4], "little")
    return json.loads(content[4:end]), content[end:]


class TestKept:
    def test_made_once(self, place: Path) -> None:
        made: list[int] = []

        def make() -> Binary:
            made.append(1)
            return binary()

        found = [cache.kept(("a", 1), make), cache.kept(("a", 1), make), cache.kept(("a", 2), make)]
        assert found == [binary()] * 3
        assert len(made) == 2
        assert stat.S_IMODE(place.stat().st_mode) == 0o700
        assert {stat.S_IMODE(path.stat().st_mode) for path in place.iterdir()} == {0o600}

    def test_a_number(self, place: Path) -> None:
        found = [cache.kept(("a",), lambda: 2**40), cache.kept(("a",), lambda: 3), cache.kept(("b",), lambda: 3)]
        assert found == [2**40, 2**40, 3]

    @pytest.mark.parametrize("damage", [b"", b"\0" * 40, b"\0" * 4000, None, "cut", "pickle"])
    def test_what_is_damaged_is_made_anew(self, place: Path, damage: Any) -> None:
        cache.kept(("a",), binary)
        (path,) = place.iterdir()
        whole = path.read_bytes()
        # What the cache was before: a digest and a pickle.
        pickled = b"cos\nsystem\n(S'false'\ntR."
        damages = {None: whole[:-1] + b"!", "cut": whole[:-1], "pickle": hashlib.sha256(pickled).digest() + pickled}
        path.write_bytes(damages.get(damage, damage))
        assert cache.kept(("a",), lambda: binary(b"new")).code == b"new"
        assert cache.kept(("a",), lambda: binary(b"newer")).code == b"new"

    @pytest.mark.parametrize(
        "changes",
        [
            {"key": "0" * 64},
            {"origin": {"jax": "0.1"}},
            {"bytes": 3},
            {"text_bytes": -1},
            {"text_bytes": 99},
            {"program": 5},
            {"program": "0" * 64},
            {"scratch_bytes": -1},
            {"scratch_bytes": True},
            {"scratch_bytes": 2**60},
            {"scratch_bytes": "64"},
            {"number": "5"},
            {"more": 1},
        ],
    )
    def test_what_is_of_another_program_or_makes_no_sense_is_made_anew(
        self, place: Path, changes: dict[str, Any]
    ) -> None:
        cache.kept(("a",), binary)
        (path,) = place.iterdir()
        header, code = opened(path)
        path.write_bytes(signed(header | changes, code))
        assert cache.kept(("a",), lambda: binary(b"new")).code == b"new"

    @pytest.mark.parametrize(
        "state",
        [
            {"structure": ["tuple"], "leaves": [], "identity": ""},
            {"structure": {"record": "os:system", "parts": {}, "settings": {}}, "leaves": [], "identity": ""},
            5,
            [],
        ],
    )
    def test_a_state_that_makes_no_sense(self, place: Path, state: Any) -> None:
        known = cache.Known("0" * 64, Packer((struct((2,), np.dtype(np.float32)),)))
        assert cache.kept(("a",), lambda: known) == known
        (path,) = place.iterdir()
        header, code = opened(path)
        path.write_bytes(signed(header | {"state": state}, code))
        assert cache.look_up(("a",)) is None

    def test_better_code_as_text_comes_back(self, place: Path) -> None:
        both = Binary(b"code", 64, b"text of better code")
        cache.keep(("a",), both)
        assert cache.look_up(("a",)) == both

    def test_the_file_of_another_program_under_this_ones_name(self, place: Path) -> None:
        cache.kept(("a",), binary)
        (first,) = place.iterdir()
        cache.kept(("b",), lambda: binary(b"other"))
        (second,) = set(place.iterdir()) - {first}
        first.write_bytes(second.read_bytes())
        assert cache.kept(("a",), lambda: binary(b"new")).code == b"new"

    def test_of_another_version_of_a_library(self, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        cache.kept(("a",), binary)
        monkeypatch.setattr(cache, "_origin", lambda rooms: {"jax": "9"})
        assert cache.kept(("a",), lambda: binary(b"new")).code == b"new"

    def test_files_that_are_none(self, place: Path) -> None:
        cache.kept(("a",), binary)
        (path,) = place.iterdir()
        elsewhere = place.parent / "elsewhere"
        path.rename(elsewhere)
        path.symlink_to(elsewhere)
        assert cache.kept(("a",), lambda: binary(b"new")).code == b"new"
        assert opened(elsewhere)[1] == binary().code
        assert cache.kept(("a",), lambda: binary(b"newer")).code == b"new"
        path.unlink()
        os.mkfifo(path)
        assert cache.kept(("a",), lambda: binary(b"newest")).code == b"newest"

    def test_a_place_that_cannot_be_written_costs_only_time(self, place: Path) -> None:
        place.write_text("a file where the folder should be")
        assert cache.kept(("a",), binary) == binary()

    @pytest.mark.parametrize("call", ["open", "replace"])
    def test_a_full_disk_costs_only_time(self, place: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
        def full(*_: Any, **__: Any) -> Any:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        cache.kept(("b",), binary)
        with monkeypatch.context() as changed, warnings.catch_warnings():
            warnings.simplefilter("error")
            changed.setattr(os, call, full)
            assert cache.kept(("a",), binary) == binary()
        # Nothing half written is left.
        assert len(list(place.iterdir())) == 1
        assert cache.look_up(("a",)) is None

    def test_a_folder_that_vanishes_is_made_again(self, place: Path) -> None:
        cache.kept(("a",), binary)
        shutil.rmtree(place)
        assert cache.kept(("a",), lambda: binary(b"new")).code == b"new"
        assert cache.kept(("a",), lambda: binary(b"newer")).code == b"new"

    def test_off(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("QRSIM_COMPILATION_CACHE", "off")
        assert cache.folder() is None
        assert cache.kept(("a",), lambda: binary(b"one")).code == b"one"
        assert cache.kept(("a",), lambda: binary(b"two")).code == b"two"

    @pytest.mark.long
    def test_processes_at_the_same_time(self, place: Path) -> None:
        program = (
            "import sys; from pathlib import Path; from qrsim.engine import cache\n"
            "from qrsim.engine.llvm import Binary\n"
            f"cache.folder = lambda: Path({str(place)!r})\n"
            "for i in range(200):\n"
            "    assert cache.kept((i % 7,), lambda: Binary(bytes([i % 7]) * 9000, 8)).code[0] == i % 7\n"
        )
        several = [subprocess.Popen([sys.executable, "-c", program]) for _ in range(2)]
        assert [each.wait(120) for each in several] == [0, 0]
        assert len(list(place.iterdir())) == 7


class TestFolder:
    def test_one_that_others_can_write_into_is_not_used(self, place: Path) -> None:
        for mode in (0o777, 0o770, 0o720):
            folders._warn.cache_clear()
            place.mkdir()
            place.chmod(mode)
            with pytest.warns(
                UserWarning, match=r"neither read from .*native nor kept there: others can write into it"
            ):
                assert cache.kept(("a",), binary) == binary()
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                assert cache.kept(("a",), lambda: binary(b"new")).code == b"new"
            assert not list(place.iterdir())
            place.rmdir()

    def test_one_that_others_can_only_read_is_closed(self, place: Path) -> None:
        place.mkdir()
        place.chmod(0o755)
        cache.kept(("a",), binary)
        assert stat.S_IMODE(place.stat().st_mode) == 0o700
        assert len(list(place.iterdir())) == 1

    def test_one_of_somebody_else(self, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        cache.kept(("a",), binary)
        monkeypatch.setattr(os, "geteuid", lambda: 12345)
        with pytest.warns(UserWarning, match=r"it belongs to another user"):
            assert cache.kept(("a",), lambda: binary(b"new")).code == b"new"

    def test_a_link(self, place: Path) -> None:
        (place.parent / "elsewhere").mkdir(mode=0o700)
        place.symlink_to(place.parent / "elsewhere")
        with pytest.warns(UserWarning, match=r"it is a symbolic link"):
            cache.kept(("a",), binary)
        assert not list((place.parent / "elsewhere").iterdir())

    def test_one_below_a_folder_that_everybody_can_write_into(self, place: Path) -> None:
        place.parent.chmod(0o777)
        with pytest.warns(UserWarning, match=r"everybody can write into"):
            cache.kept(("a",), binary)
        # As /tmp is: nobody can put another folder in the place of this one.
        place.parent.chmod(0o1777)
        assert folders.private(place)

    def test_what_killed_processes_left_is_cleared_away(self, place: Path) -> None:
        with subprocess.Popen([sys.executable, "-c", ""]) as ended:
            ended.wait()
        place.mkdir(mode=0o700)
        left = [place / f"key.{ended.pid}.17.tmp", place / "tmpabcdefgh"]
        others = [place / f"key.{os.getpid()}.17.tmp", place / "other.bin"]
        for path in (*left, *others):
            path.write_bytes(b"half")
        os.utime(left[1], (1e9, 1e9))
        cache.kept(("a",), binary)
        assert not any(path.exists() for path in left)
        assert all(path.exists() for path in others)
        assert len(list(place.iterdir())) == 3

    @pytest.mark.parametrize(("minutes", "kept"), [(58, True), (62, False)])
    def test_who_takes_longer_than_an_hour_has_been_killed(self, tmp_path: Path, minutes: int, kept: bool) -> None:
        path = tmp_path / "tmpabcdefgh"
        path.write_bytes(b"half")
        then = time.time() - 60.0 * minutes
        os.utime(path, (then, then))
        folders.tidy(tmp_path)
        assert path.exists() == kept

    def test_what_was_used_longest_ago_goes_first(self, tmp_path: Path) -> None:
        for age in range(10):
            (tmp_path / f"{age}.bin").write_bytes(bytes(1000))
            os.utime(tmp_path / f"{age}.bin", (2e9 - age, 2e9 - age))
        folders.tidy(tmp_path, 10_000)
        assert len(list(tmp_path.iterdir())) == 10
        folders.tidy(tmp_path, 8000)
        assert sorted(path.stem for path in tmp_path.iterdir()) == ["0", "1", "2", "3", "4", "5"]

    def test_to_read_a_program_is_to_use_it(self, place: Path) -> None:
        cache.kept(("a",), binary)
        (path,) = place.iterdir()
        os.utime(path, (1e9, 1e9))
        cache.kept(("a",), binary)
        assert path.stat().st_mtime > 1.5e9


@record
class Theirs:
    """A part of a world that is not of this package."""

    value: Any = quantity(doc="something")
    kind: tuple[str, float] = setting(default=("a", 0.1), doc="a setting")


class TestStructure:
    def test_there_and_back(self) -> None:
        simulation = qrsim.load("plume_mapping/3F")
        simulation.reset()
        layout = simulation.packed[0]
        leaves = list(map(struct, layout.shapes, layout.dtypes))
        plain = json.loads(json.dumps(to_plain(layout.structure)))
        assert Packer(from_plain(plain, iter(leaves))) == layout

    def test_a_start_comes_back_as_it_was(self, place: Path) -> None:
        template = (None, [Vec3(*[struct((2,), np.dtype(np.float32))] * 3)], Theirs(struct((), np.dtype(bool))))
        layout = Packer(template)
        cache.keep(("a",), cache.Known("0" * 64, layout))
        found = cache.look_up(("a",))
        assert found.program == "0" * 64
        assert found.state == layout
        assert found.state.template()[2].kind == ("a", 0.1)

    def test_what_has_no_name_is_not_kept(self, place: Path) -> None:
        @record
        class Local:
            value: Any = quantity(doc="something")

        cache.keep(("a",), cache.Known("0" * 64, Packer(Local(struct((), np.dtype(bool))))))
        assert not list(place.iterdir())

    def test_code_of_others_is_not_kept(self, place: Path) -> None:
        """It can change without a change of its name."""
        layout = Packer(Theirs(jnp.zeros(3)))
        cache.kept(("tick", cache.identity(layout)), binary)
        assert not place.exists()
        cache.kept(("tick", cache.identity(Packer(Vec3(*jnp.zeros((3, 3)))))), binary)
        assert len(list(place.iterdir())) == 1

    def test_two_types_of_one_name_are_two_layouts(self) -> None:
        def make() -> Any:
            @record
            class Twin:
                value: Any = quantity(doc="something")

            return Twin

        some, other = make(), make()
        assert Packer(some(jnp.zeros(3))) == Packer(some(jnp.ones(3)))
        assert Packer(some(jnp.zeros(3))) != Packer(other(jnp.zeros(3)))


def test_a_simulation_of_a_damaged_cache_flies(place: Path) -> None:
    """Every file of the cache altered, cut or of another program: the flight is the same."""
    from qrsim.engine.programs import forget

    def flown() -> bytes:
        forget()
        simulation = qrsim.load("hover_ideal", seed=2)
        simulation.reset()
        simulation.step(ticks=5)
        return simulation.save()

    first = flown()
    files = sorted(place.iterdir())
    # The start and the tick: where their structures lead, and their code.
    assert len(files) == 4
    contents = [path.read_bytes() for path in files]
    for i, path in enumerate(files):
        path.write_bytes([contents[(i + 1) % 4], contents[i][:-9] + b"123456789"][i % 2])
    assert flown() == first
    assert [path.read_bytes() for path in files] == contents


class TestTwoKeys:
    """Machine code is found by the structure of its inputs, or else by the program that is traced."""

    @pytest.fixture
    def built(self, place: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
        """What was compiled."""
        names: list[str] = []

        def build(*arguments: Any) -> Binary:
            names.append("code")
            return by_llvm_build(*arguments)

        by_llvm_build = by_llvm.build
        monkeypatch.setattr(by_llvm, "build", build)
        return names

    @staticmethod
    def flown(gain: float) -> Any:
        """Fly a policy of a user, which nothing but tracing can tell from another one."""
        programs.forget()
        found = qrsim.rollout("hover_ideal", jax.jit(lambda reading: jnp.full((1, 5), gain)), worlds=1, ticks=5, seed=3)
        return np.asarray(found.metrics["distance_m"])

    def test_users_code_is_compiled_once_and_again_when_it_changes(self, built: list[str]) -> None:
        first = self.flown(0.25)
        once = len(built)
        assert once == 2
        np.testing.assert_array_equal(self.flown(0.25), first)
        assert len(built) == once
        assert (self.flown(0.5) != first).any()
        # The start does not ask the policy.
        assert len(built) == once + 1

    def test_an_edit_of_what_is_traced_costs_no_compilation(self, built: list[str], monkeypatch: Any) -> None:
        def reset() -> bytes:
            programs.forget()
            simulation = qrsim.load("hover_ideal", seed=2)
            simulation.reset()
            return simulation.save()

        first, sources = reset(), cache._sources
        assert len(built) == 1
        cache._origin.cache_clear()
        monkeypatch.setattr(cache, "_sources", lambda rooms: "edited" if "models" in rooms else sources(rooms))
        try:
            assert reset() == first
            assert len(built) == 1
            # The code generator itself is another matter.
            cache._origin.cache_clear()
            monkeypatch.setattr(cache, "_sources", lambda rooms: "edited generator")
            assert reset() == first
            assert len(built) == 2
        finally:
            monkeypatch.undo()
            cache._origin.cache_clear()


@pytest.mark.nightly
def test_all_that_is_traced_lies_in_the_rooms_that_the_first_key_digests() -> None:
    root = Path(qrsim.__file__).parent
    seen = set()
    for name in ("mixed_team", "street_canyon", "formation_radio", "plume_mapping/3F"):
        world = qrsim.load_scenario(name).world()
        keys, checker = keys_of(world, Key.root(0, 0)), ActionChecker(world, np.dtype(np.float32))
        start, state = jax.make_jaxpr(ticks_of.reset, return_shape=True)(world, keys)
        given = checker.actions(None, lambda: None), checker.estimates(None)
        tick = jax.make_jaxpr(ticks_of.step)(world, state, jnp.int32(0), *given)
        seen |= files_of(start.jaxpr) | files_of(tick.jaxpr)
    own = {path.relative_to(root) for path in seen if path.is_relative_to(root)}
    assert {path.parts[0] for path in own} >= {"control", "core", "models", "world"}
    assert not [path for path in own if not any(path.is_relative_to(room) for room in cache.TRACED)]


def files_of(jaxpr: Any) -> set[Path]:
    """The files of all lines that led to an equation, those of inner programs included."""
    found: set[Path] = set()
    for equation in jaxpr.eqns:
        traceback = equation.source_info.traceback
        if traceback is not None:
            # The frames from the traced function inwards.
            found |= {Path(frame.file_name) for frame in traceback.frames}
        for inner in jaxprs_in_params(equation.params):
            found |= files_of(inner)
    return found
