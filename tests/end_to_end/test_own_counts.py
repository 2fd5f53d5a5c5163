"""A scan assembled by hand from files of three makers is corrected as the scan that it is."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import legsim as ls
from legsim.deformation.files import load_motion
from legsim.geometry import image_files
from legsim.geometry.cone_beam import Projections
from tests.examples import measured

SCRIPT = Path(__file__).parents[2] / "docs/examples/own_counts.py"


@pytest.fixture(scope="module")
def own_counts():
    spec = importlib.util.spec_from_file_location("own_counts", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def folder(tmp_path, own_counts):
    """A scan whose first three columns see air, and its files by hand."""
    path = measured.write(tmp_path / "scan")
    geometry = measured.geometry()
    read = image_files.load_projections(tmp_path / "scan/projections.mha", geometry)
    images = read.line_integrals.copy()
    images[:, :, :3] = 0
    image_files.save_projections(tmp_path / "scan/projections.mha", Projections(geometry, images))
    text = path.read_text().replace("position_mm", 'known = "roughly"\nposition_mm')
    path.write_text(text[: text.index("[grid]")])
    own_counts.write(ls.load_measured_scan(path), tmp_path / "own")
    return tmp_path


def test_it_is_read_as_the_same_scan(folder):
    ours, theirs = (ls.load_measured_scan(folder / f"{name}/scan.toml") for name in ("scan", "own"))
    given, read = ours.seen.projections, theirs.seen.projections
    # counts are whole, about 20000 behind the object
    np.testing.assert_allclose(read.line_integrals, given.line_integrals, atol=1e-4)
    center = given.geometry.rotation_center() + 0.03 * np.eye(3)
    pixels = [p.geometry.project(center)[0] for p in (given, read)]
    np.testing.assert_allclose(pixels[1], pixels[0], atol=1e-6)
    np.testing.assert_allclose(theirs.seen.signals.times, ours.seen.signals.times, atol=1e-9)
    for name in ("specific_force", "angular_velocity"):
        values = [getattr(scan.seen.signals, name) for scan in (theirs, ours)]
        np.testing.assert_allclose(*values, atol=1e-6)
    assert theirs.grid.alike(ours.grid)
    assert any("the field of view" in note for note in theirs.notes)


@pytest.mark.end_to_end
def test_it_is_corrected_as_the_same_scan(folder):
    """Starts are rounded alike, as both are leveled by the same signals."""
    for name in ("scan", "own"):
        ls.correct(folder / f"{name}/scan.toml", ["rigid", "standing"], folder / f"out_{name}")
    for method in ("uncorrected", "rigid", "standing"):
        found, expected = (
            image_files.load_volume(folder / f"out_{name}/volume-{method}.mha").attenuation
            for name in ("own", "scan")
        )
        assert np.abs(found - expected).max() < 0.01 * np.abs(expected).max()
    motions = [load_motion(folder / f"out_{name}/motion-rigid.npz") for name in ("own", "scan")]
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]])
    found, expected = (motion.carry(points) for motion in motions)
    # the poses of the starts are rounded to a centimeter and a degree
    assert np.abs(found - expected).max() < 2e-3
    assert np.abs(expected - points).max() > 5e-3
    assert list((folder / "out_own/pictures").glob("*.png"))
