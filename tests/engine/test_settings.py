"""Settings of the process: devices and the cache of compiled programs."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax
import pytest

import qrsim
from qrsim.engine import settings as configuration
from qrsim.errors import UsageError


class FakeConfig(SimpleNamespace):
    """As much of JAX's configuration as is used here."""

    def update(self, name: str, value: Any) -> None:
        setattr(self, name, value)


@pytest.fixture
def config(monkeypatch: pytest.MonkeyPatch) -> FakeConfig:
    fake = FakeConfig(jax_compilation_cache_dir=None)
    monkeypatch.setattr(configuration, "jax", SimpleNamespace(config=fake))
    monkeypatch.delenv("QRSIM_COMPILATION_CACHE", raising=False)
    return fake


class TestDevices:
    """A second device is tested in a process of its own, see test_rollout.py."""

    @pytest.mark.parametrize("number", [0, -1, 1.5, "2", True])
    def test_no_number_of_devices(self, number: Any):
        with pytest.raises(UsageError, match=r"cpu_devices: .* is not a positive whole number"):
            qrsim.configure(cpu_devices=number)

    def test_too_late(self):
        started = len(jax.devices("cpu"))
        with pytest.raises(UsageError, match=f"JAX has already started with {started}; call qrsim.configure before"):
            qrsim.configure(cpu_devices=started + 1)

    def test_what_is_so_already_is_fine(self):
        qrsim.configure(cpu_devices=len(jax.devices("cpu")))
        qrsim.configure()

    def test_in_time(self, config):
        qrsim.configure(cpu_devices=3)
        assert config.jax_num_cpu_devices == 3

    def test_cores(self):
        assert configuration.available_cores() >= 1


class TestQuickToCompile:
    def test_an_option_that_this_xla_does_not_have_is_left_out(self, monkeypatch: pytest.MonkeyPatch):
        configuration.quick_to_compile.cache_clear()
        monkeypatch.setattr(configuration, "_QUICK_TO_COMPILE", {"xla_cpu_no_such_option": True})
        try:
            assert configuration.quick_to_compile() == {}
            assert int(configuration.quick_jit(lambda x, n: x * n, static_argnums=1)(3, 2)) == 6
        finally:
            configuration.quick_to_compile.cache_clear()

    def test_an_option_that_it_has_is_used(self, monkeypatch: pytest.MonkeyPatch):
        configuration.quick_to_compile.cache_clear()
        monkeypatch.setattr(configuration, "_QUICK_TO_COMPILE", {"xla_cpu_enable_fast_math": False})
        try:
            assert configuration.quick_to_compile() == {"xla_cpu_enable_fast_math": False}
        finally:
            configuration.quick_to_compile.cache_clear()


class TestCompilationCache:
    def test_in_the_users_cache_by_default(self, config, monkeypatch, tmp_path):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        monkeypatch.delenv("QRSIM_CACHE_DIR", raising=False)
        configuration.use_compilation_cache()
        assert config.jax_compilation_cache_dir.endswith("compiled")
        assert "qrsim" in config.jax_compilation_cache_dir

    def test_not_where_others_can_write(self, config, monkeypatch, tmp_path):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        monkeypatch.delenv("QRSIM_CACHE_DIR", raising=False)
        (tmp_path / "qrsim" / "compiled").mkdir(parents=True)
        (tmp_path / "qrsim" / "compiled").chmod(0o777)
        with pytest.warns(UserWarning, match="others can write into it"):
            configuration.use_compilation_cache()
        assert vars(config) == {"jax_compilation_cache_dir": None}

    def test_where_jax_was_told(self, config):
        config.jax_compilation_cache_dir = "/elsewhere"
        configuration.use_compilation_cache()
        assert vars(config) == {"jax_compilation_cache_dir": "/elsewhere"}

    def test_off(self, config, monkeypatch):
        monkeypatch.setenv("QRSIM_COMPILATION_CACHE", "off")
        configuration.use_compilation_cache()
        assert vars(config) == {"jax_compilation_cache_dir": None}
