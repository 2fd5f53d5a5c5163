"""The recording that several test files read back."""

import pytest
import rerun as rr

from legsim import view
from tests.examples import scene as example_scene


@pytest.fixture(autouse=True)
def _strict():
    """Bad input to rerun raises instead of warning."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="session")
def scene():
    return example_scene.scan_scene()


@pytest.fixture(scope="session")
def written(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "recording.rrd"
    view.write_scan(path, scene)
    return path
