"""The built wheel works where there is no checkout: models, recordings, kernels and templates come
along.
"""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
SCRIPT = """
import legsim

from legsim.core import resources
from legsim.kinematics import solve_kinematics
from legsim.opencl import open_device
from legsim.report import ReportContent, render
assert not legsim.__file__.startswith({root!r}), legsim.__file__
assert solve_kinematics("subject01/squat_60.trc").fit.ik.rms < 5e-3
device = open_device()
from legsim.phantom import load_leg_phantom
assert load_leg_phantom().phantom.parts
assert "<html" in render(ReportContent("title", ("one",)))
from legsim import figures, view
assert callable(figures.png) and callable(view.write_replay)
from importlib.resources import files
for path in files("legsim.opencl").joinpath("kernels").iterdir():
    assert path.read_text()
print(resources.model_file("lower_body/lower_body.xml"))
"""


def test_the_wheel_runs_outside_the_checkout(tmp_path):
    build = [
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--outdir",
        str(tmp_path / "dist"),
        str(ROOT),
    ]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    install = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--no-index",
        "--target",
        str(tmp_path / "site"),
        str(wheel),
    ]
    subprocess.run(install, check=True, capture_output=True)
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "site")}
    script = SCRIPT.format(root=str(ROOT))
    result = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert str(tmp_path / "site") in result.stdout
