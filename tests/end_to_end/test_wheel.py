"""What a release consists of works where there is no checkout: the sdist builds the wheel, and the
installed wheel has its commands, models, recordings, kernels, studies and templates.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import pytest

ROOT = Path(__file__).parents[2]
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
SCRIPT = """
import json
import legsim
from legsim.core import resources
from legsim.imu.catalogue import sensor_catalogue
from legsim.kinematics import solve_kinematics
from legsim.opencl import open_device
from legsim.phantom import load_leg_phantom
from legsim.report import ReportContent, render
assert solve_kinematics("subject01/squat_60.trc").fit.ik.rms < 5e-3
open_device()
assert load_leg_phantom().phantom.parts
assert "<html" in render(ReportContent("title", ("one",)))
from legsim import figures, view
assert callable(figures.png) and callable(view.write_replay)
print(json.dumps({
    "package": legsim.__file__,
    "version": legsim.__version__,
    "sensors": len(sensor_catalogue()),
    "model": str(resources.model_file("lower_body/lower_body.xml")),
}))
"""


@dataclass(frozen=True)
class Release:
    """The two files of a release, and a place that the wheel is installed in."""

    sdist: Path
    wheel: Path
    bin: Path

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        """Runs a command of the installation in an empty folder."""
        folder = self.bin.parent / "empty"
        folder.mkdir(exist_ok=True)
        own = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
        found = shutil.which(command[0], path=str(self.bin))
        assert found, f"{command[0]} was not installed"
        return subprocess.run(
            [found, *command[1:]], cwd=folder, env=own, capture_output=True, text=True
        )


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Release:
    """Builds the sdist, from it the wheel, and installs that beside this environment's libraries."""
    folder = tmp_path_factory.mktemp("release")
    python = [sys.executable, "-m"]
    build = [*python, "build", "--no-isolation", "--outdir", str(folder / "dist"), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,), (sdist,) = ((folder / "dist").glob(f"*.{k}") for k in ("whl", "tar.gz"))
    home = folder / "venv"
    venv.create(home)
    schemes = {"base": str(home), "platbase": str(home)}
    site = Path(sysconfig.get_path("purelib", "venv", vars=schemes))
    # after the environment's own folder, so that the checkout's legsim is not the one that is found
    (site / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    scripts = Path(sysconfig.get_path("scripts", "venv", vars=schemes))
    install = ["--quiet", "--no-deps", "--no-index", "--ignore-installed", str(wheel)]
    inside = shutil.which("python", path=str(scripts))
    assert inside
    subprocess.run(
        [*python, "pip", "--python", inside, "install", *install], check=True, capture_output=True
    )
    return Release(sdist, wheel, scripts)


def shipped(folder: str) -> set[str]:
    """Files of a folder of the checkout."""
    found = (p for p in (ROOT / folder).rglob("*") if p.is_file() and "__pycache__" not in p.parts)
    return {p.relative_to(ROOT).as_posix() for p in found if not p.name.startswith(".")}


def test_the_wheel_has_every_file_and_no_other(release):
    names = {n for n in zipfile.ZipFile(release.wheel).namelist() if ".dist-info/" not in n}
    data = {f"legsim/data/{name}" for folder in ("models", "motions") for name in shipped(folder)}
    assert names == shipped("legsim") | data


def test_the_sdist_has_what_tests_and_documents_need(release):
    with tarfile.open(release.sdist) as archive:
        names = {str(PurePosixPath(*PurePosixPath(n).parts[1:])) for n in archive.getnames()}
    for folder in ("legsim", "models", "motions", "tests", "tools", "docs"):
        assert not shipped(folder) - names, folder
    files = "README.md CHANGELOG.md LICENSE CITATION.cff Makefile mkdocs.yml pyproject.toml"
    assert not set(files.split()) - names


def test_the_wheel_runs_outside_the_checkout(release):
    result = release.run("python", "-c", SCRIPT)
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    for key in ("package", "model"):
        assert found[key].startswith(str(release.bin.parent))
    assert found["version"] == VERSION
    assert found["sensors"] == len(list((ROOT / "models/sensors").glob("*.toml")))


def test_its_commands_start(release):
    assert release.run("legsim", "--version").stdout.split() == ["legsim", VERSION]
    doctor = release.run("legsim", "doctor")
    lines = [line for line in doctor.stdout.splitlines() if re.search(r"package|models", line)]
    assert len(lines) > 15, doctor.stderr
    assert all(line.startswith("ok") for line in lines), doctor.stdout
    assert f"package legsim: {VERSION}" in doctor.stdout
    studies = release.run("legsim", "study", "nothing", "--out", "out")
    names = {path.stem for path in (ROOT / "legsim/study/shipped").glob("*.toml")}
    assert all(name in studies.stderr for name in names), studies.stderr
    sensors = release.run("legsim", "sensors")
    assert sensors.returncode == 0, sensors.stderr
