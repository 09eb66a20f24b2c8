"""The wheel, installed as a user would: into an empty environment, with the newest dependencies that it allows."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long
ROOT = Path(__file__).parents[1]
# The largest installation that is promised: distributions (pip and setuptools not counted) without any extra.
MOST_DISTRIBUTIONS = 35
LIST = """
import importlib.metadata as metadata, json
print(json.dumps({d.metadata["Name"].lower(): d.version for d in metadata.distributions()}))
"""
ROLLOUT = """
import qrsim
qrsim.configure(compiler="xla")
flights = qrsim.rollout(qrsim.make_world(vehicles=[[0, 0, -10], [5, 0, -10]]), ticks=50, worlds=4)
print(flights)
"""


def newest_python() -> str:
    """The newest interpreter of this machine that the package supports."""
    installed = Path(os.environ.get("PYENV_ROOT", "/nowhere")) / "versions"
    for minor in (13, 12):
        candidates = [shutil.which(f"python3.{minor}"), *map(str, sorted(installed.glob(f"3.{minor}.*/bin/python")))]
        for candidate in candidates:
            if candidate and subprocess.run([candidate, "-c", "import venv, ensurepip"], check=False).returncode == 0:
                return candidate
    return sys.executable


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(ROOT)]
    subprocess.run(command, check=True, timeout=300)
    (found,) = folder.glob("qrsim-*.whl")
    return found


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """An interpreter with the wheel and what it depends on, and nothing else."""
    folder = tmp_path_factory.mktemp("installed")
    subprocess.run([newest_python(), "-m", "venv", str(folder / "venv")], check=True, timeout=120)
    found = str(folder / "venv" / "bin" / "python")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PIP_CONSTRAINT")}
    command = [found, "-m", "pip", "install", "--quiet", "--upgrade", str(wheel)]
    subprocess.run(command, check=True, timeout=900, env=environment)
    return found


def qrsim(python: str, folder: Path, *words: str, **variables: str) -> str:
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "QRSIM_COMPILER")}
    environment |= {"XDG_CACHE_HOME": str(folder / "cache")} | variables
    done = subprocess.run(
        [python, *words], capture_output=True, text=True, timeout=600, check=False, env=environment, cwd=folder
    )
    assert done.returncode == 0, done.stderr + done.stdout
    assert "Traceback" not in done.stderr
    return done.stdout


def test_it_is_small(python: str, tmp_path: Path):
    found = json.loads(qrsim(python, tmp_path, "-c", LIST))
    found.pop("pip", None)
    found.pop("setuptools", None)
    assert "pytest" not in found
    assert len(found) <= MOST_DISTRIBUTIONS, sorted(found)


@pytest.mark.parametrize(
    "words",
    [
        ["run", "outdoor_patrol", "--duration", "2"],
        ["run", "plume_mapping/3A", "--duration", "2", "--policy", "baseline"],
        ["run", "search_and_rescue/2D", "--duration", "2", "--policy", "baseline"],
        ["slam", "--seeds", "1", "--duration", "10"],
    ],
    ids=lambda words: words[1],
)
def test_it_flies(python: str, tmp_path: Path, words: list[str]):
    qrsim(python, tmp_path, "-m", "qrsim.cli", *words, "--out", "run")
    assert (tmp_path / "run").is_dir()


def test_it_flies_by_xla(python: str, tmp_path: Path):
    qrsim(python, tmp_path, "-m", "qrsim.cli", "run", "hover", "--duration", "1", "--out", "run", QRSIM_COMPILER="xla")
    qrsim(python, tmp_path, "-c", ROLLOUT)


def test_it_plots(python: str, tmp_path: Path):
    qrsim(python, tmp_path, "-m", "qrsim.cli", "run", "hover", "--duration", "1", "--out", "run", "--no-figure")
    qrsim(python, tmp_path, "-m", "qrsim.cli", "plot", "run", "--out", "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
