"""Fixtures that several test files share."""

import os
from pathlib import Path

import numpy as np
import pytest

from legsim import opencl

SHARED = Path(os.environ.get("LEGSIM_SHARED", Path(__file__).parents[2] / "shared"))


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test that asks for ``device`` runs on every OpenCL device that works here."""
    if "device" in metafunc.fixturenames:
        labels = [c.label for c in opencl.candidates() if c.seconds is not None]
        metafunc.parametrize("device", labels, indirect=True, scope="session")


@pytest.fixture(scope="session")
def device(request: pytest.FixtureRequest) -> opencl.Device:
    """One working OpenCL device."""
    return opencl.open_device(request.param)


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
