"""The wheel, installed as a user would: into an empty environment, with the newest dependencies that it allows.

That environment takes a minute, so it is nightly. The long tier runs the files of the wheel on the packages that it
has; tests/test_extras.py shows that those without an extra are enough.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# The largest installation that is promised, without any extra; pip and setuptools are not counted.
MOST_DISTRIBUTIONS = 35
MOST_MIB = 1050.0
# Name -> size of its files [MiB], without what is compiled of its own tests.
LIST = """
import importlib.metadata as metadata, json
def size(distribution):
    files = [f for f in distribution.files or () if f.suffix != ".pyc" or not {"test", "tests"} & set(f.parts)]
    return sum(p.stat().st_size for f in files if (p := distribution.locate_file(f)).is_file()) / 2**20
print(json.dumps({d.metadata["Name"].lower(): size(d) for d in metadata.distributions()}))
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
    for minor in (14, 13, 12):
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
def unpacked(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of the wheel."""
    folder = tmp_path_factory.mktemp("unpacked")
    with zipfile.ZipFile(wheel) as files:
        files.extractall(folder)
    return folder


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """An interpreter with the wheel and what it depends on, and nothing else."""
    return installed(newest_python(), tmp_path_factory.mktemp("newest"), str(wheel))


@pytest.fixture(scope="module")
def oldest(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """An interpreter with the wheel and the oldest dependencies that it allows."""
    if sys.version_info[:2] != (3, 11):
        pytest.skip("the oldest dependencies are those of Python 3.11: make test-long PYTHON=python3.11")
    folder = tmp_path_factory.mktemp("oldest")
    allowed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    bounds = [re.match(r"([\w-]+)>=([\d.]+)", line) for line in allowed]
    constraints = folder / "constraints.txt"
    constraints.write_text("".join(f"{b[1]}=={b[2]}.*\n" for b in bounds if b), encoding="utf-8")
    return installed(sys.executable, folder, "--constraint", str(constraints), str(wheel))


def installed(python: str, folder: Path, *words: str) -> str:
    subprocess.run([python, "-m", "venv", str(folder / "venv")], check=True, timeout=120)
    found = str(folder / "venv" / "bin" / "python")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PIP_CONSTRAINT")}
    subprocess.run([found, "-m", "pip", "install", "--quiet", *words], check=True, timeout=900, env=environment)
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


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["laser", "point_mass", "climb"])
def test_components_of_ones_own(python: str, tmp_path: Path, name: str):
    """The examples of docs/reference/contracts.md, copied to where a user has them."""
    for ending in ("py", "yaml"):
        file = f"{name}.{ending}"
        (tmp_path / file).write_bytes((ROOT / "examples" / "outside" / file).read_bytes())
    qrsim(python, tmp_path, "-m", "qrsim.cli", "run", f"{name}.yaml", "--duration", "2", "--out", "run", "--no-figure")
    (needed,) = json.loads((tmp_path / "run" / "run.json").read_text(encoding="utf-8"))["components"]
    assert needed["file"] == str(tmp_path / f"{name}.py")


@pytest.mark.nightly
def test_it_is_small(python: str, tmp_path: Path):
    found = json.loads(qrsim(python, tmp_path, "-c", LIST))
    found.pop("pip", None)
    found.pop("setuptools", None)
    assert "pytest" not in found
    assert len(found) <= MOST_DISTRIBUTIONS, sorted(found)
    assert found["jaxlib"] > 100.0, "sizes are measured"
    assert sum(found.values()) <= MOST_MIB


@pytest.mark.nightly
@pytest.mark.parametrize(
    "words",
    [
        ["run", "patrol_plain", "--duration", "2"],
        ["run", "plume_mapping/3A", "--duration", "2", "--policy", "baseline"],
        ["run", "search_and_rescue/2D", "--duration", "2", "--policy", "baseline"],
        ["slam", "--seeds", "1", "--duration", "10"],
    ],
    ids=lambda words: words[1],
)
def test_it_flies(python: str, tmp_path: Path, words: list[str]):
    qrsim(python, tmp_path, "-m", "qrsim.cli", *words, "--out", "run")
    assert (tmp_path / "run").is_dir()


@pytest.mark.long
def test_the_wheel_has_every_file_and_flies(unpacked: Path, tmp_path: Path):
    def files(folder: Path) -> set[Path]:
        every = (
            path for path in (folder / "qrsim").rglob("*") if path.is_file() and path.suffix not in (".pyc", ".md")
        )
        return {path.relative_to(folder) for path in every}

    assert files(unpacked) == files(ROOT / "src")
    # The caches of programs are alike, because the sources are.
    variables = {"PYTHONPATH": str(unpacked), "XDG_CACHE_HOME": os.environ.get("XDG_CACHE_HOME", str(tmp_path))}
    found = qrsim(sys.executable, tmp_path, "-c", "import qrsim; print(qrsim.__file__)", **variables)
    assert Path(found.strip()) == unpacked / "qrsim" / "__init__.py"
    qrsim(
        sys.executable,
        tmp_path,
        "-m",
        "qrsim.cli",
        "run",
        "patrol_plain",
        "--duration",
        "2",
        "--out",
        "run",
        **variables,
    )
    assert (tmp_path / "run" / "figure.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
def test_the_readme_of_the_wheel_leads_to_the_tag(wheel: Path):
    with zipfile.ZipFile(wheel) as packed:
        (name,) = (name for name in packed.namelist() if name.endswith(".dist-info/METADATA"))
        text = packed.read(name).decode("utf-8")
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    links = [link for link in re.findall(r"\]\(([^)\s]+)\)", text) if not link.startswith("#")]
    assert len(links) > 20
    assert [link for link in links if not link.startswith("https://")] == []
    assert f"https://github.com/OWNER/qrsim/raw/v{version}/docs/images/turbulence_gust.gif" in links
    assert f"https://github.com/OWNER/qrsim/blob/v{version}/docs/start/install.md" in links


@pytest.mark.nightly
def test_it_flies_by_xla(python: str, tmp_path: Path):
    qrsim(
        python,
        tmp_path,
        "-m",
        "qrsim.cli",
        "run",
        "hover_ideal",
        "--duration",
        "1",
        "--out",
        "run",
        QRSIM_COMPILER="xla",
    )
    qrsim(python, tmp_path, "-c", ROLLOUT)


@pytest.mark.nightly
def test_it_plots(python: str, tmp_path: Path):
    qrsim(python, tmp_path, "-m", "qrsim.cli", "run", "hover_ideal", "--duration", "1", "--out", "run", "--no-figure")
    qrsim(python, tmp_path, "-m", "qrsim.cli", "plot", "run", "--out", "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.nightly
def test_it_flies_and_plots_with_the_oldest_dependencies(oldest: str, tmp_path: Path):
    assert qrsim(oldest, tmp_path, "-c", "import jax; print(jax.__version__)").startswith("0.8.")
    qrsim(oldest, tmp_path, "-m", "qrsim.cli", "run", "patrol_plain", "--duration", "1", "--out", "run")
    assert (tmp_path / "run" / "figure.png").read_bytes().startswith(b"\x89PNG")
