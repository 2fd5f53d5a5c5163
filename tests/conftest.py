"""Fixtures that several test files share."""

import os
import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from legsim import config
from legsim.opencl import discovery
from legsim.opencl.device import Device, open_device
from legsim.reconstruction.weights import ShortScanWarning
from legsim.report.page import Picture, ReportContent
from legsim.run import pipeline
from legsim.study import report
from tests.examples import study as example_study
from tests.peers.agreement import agree, pytest_terminal_summary

__all__ = ["agree", "pytest_terminal_summary"]

# the same examples on every machine, however busy it is
settings.register_profile("legsim", deadline=None, derandomize=True)
settings.load_profile("legsim")

SHARED = Path(os.environ.get("LEGSIM_SHARED", Path(__file__).parents[2] / "shared"))

ON_REQUEST = ("slow", "peer", "gpu")
"""Markers whose tests run only where ``-m`` names them"""

WHOLE_RUNS = {"tiny_run"}
"""Fixtures that run a whole scan: what uses them is marked end_to_end"""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the tests of whole runs; leave out those that are to be asked for by name."""
    asked = set(re.findall(r"\w+", config.option.markexpr))
    unasked = set(ON_REQUEST) - asked
    kept, left_out = [], []
    for item in items:
        if item.path.parent.name == "end_to_end" or WHOLE_RUNS & set(fixtures_of(item)):
            item.add_marker("end_to_end")
        names = {mark.name for mark in item.iter_markers()}
        (left_out if names & unasked else kept).append(item)
    config.hook.pytest_deselected(items=left_out)
    items[:] = kept


def fixtures_of(item: pytest.Item) -> list[str]:
    """Names of all fixtures that a test uses, directly or not."""
    return item.fixturenames if isinstance(item, pytest.Function) else []


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test that asks for ``device`` runs on every OpenCL device that works here."""
    if "device" in metafunc.fixturenames:
        labels = [c.label for c in discovery.candidates() if c.seconds is not None]
        metafunc.parametrize("device", labels, indirect=True, scope="session")


@pytest.fixture(scope="session")
def device(request: pytest.FixtureRequest) -> Device:
    """One working OpenCL device."""
    return open_device(request.param)


@pytest.fixture
def rng() -> np.random.Generator:
    """Seeded, so that a failure can be seen again."""
    return np.random.default_rng(20260)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder with real recordings, where there is one; they are not part of the project."""
    folder = SHARED / "data"
    if not folder.is_dir():
        pytest.skip(f"no folder of real recordings at {folder} (set LEGSIM_SHARED)")
    return folder


@pytest.fixture(scope="session")
def tiny_settings() -> config.RunConfig:
    """The paper's scan at a fifth of its resolution, every other view: seconds, and still a scan of
    8 s.
    """
    return config.load_settings(
        preset="paper",
        overrides=(
            "motion.file=subject06/squat_60.trc",  # sways most, so that the coarse voxels show it
            *(
                "scan.views=124",
                "scan.increment_deg=1.6",
                "scan.rate_hz=15.5",
                "scan.columns=124",
                "scan.rows=96",
                "scan.pixel_mm=3.08",
            ),
            *(
                "grid.voxels=80",
                "grid.voxel_mm=3.0",
                'methods.run=["static","uncorrected","oracle","rigid"]',
            ),
        ),
    )


@pytest.fixture(scope="session")
def tiny_run(
    tmp_path_factory: pytest.TempPathFactory, tiny_settings: config.RunConfig
) -> pipeline.RunResult:
    """That scan, run once for all tests that look at what a run leaves."""
    with warnings.catch_warnings():
        # the paper's scan is a little short, and says so; whichever test asks for it first must not
        # fail by that
        warnings.simplefilter("ignore", ShortScanWarning)
        return pipeline.run_scan(
            tiny_settings, tmp_path_factory.mktemp("run"), on_progress=lambda *_: None
        )


@dataclass(frozen=True)
class WrittenStudy:
    """A study's report as it was written, and what it says."""

    folder: Path
    content: ReportContent


@pytest.fixture(scope="session")
def written_study(tmp_path_factory: pytest.TempPathFactory) -> WrittenStudy:
    """The report of the example study, made once for all tests that look at it."""
    folder = tmp_path_factory.mktemp("study")
    picture = Picture(
        "Slices of every method.", example_study.picture(), "slices", "pictures/slices.png"
    )
    return WrittenStudy(folder, report.write(folder, example_study.results(), (picture,)))
