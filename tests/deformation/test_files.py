"""Motion files give back what was written."""

import zipfile

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.deformation.files import load_motion, save_motion
from legsim.deformation.models import ControlPointMotion, FieldMotion
from legsim.deformation.polyrigid import PolyrigidMotion
from legsim.geometry.volume import VolumeGrid


def test_every_kind_of_motion_survives_the_file(tmp_path, rng):
    points = ControlPointMotion(np.arange(3.0), rng.normal(size=(4, 3)), rng.normal(size=(3, 4, 3)))
    save_motion(tmp_path / "p.npz", points)
    loaded = load_motion(tmp_path / "p.npz")
    assert isinstance(loaded, ControlPointMotion)
    np.testing.assert_array_equal(loaded.moved, points.moved)
    np.testing.assert_array_equal(loaded.reference, points.reference)
    field = FieldMotion(
        np.arange(3.0),
        VolumeGrid((2, 3, 4), (0.1, 0.2, 0.3), (1, 2, 3)),
        rng.normal(size=(3, 2, 3, 4, 3)),
    )
    save_motion(tmp_path / "f.npz", field)
    loaded = load_motion(tmp_path / "f.npz")
    assert isinstance(loaded, FieldMotion)
    assert loaded.grid == field.grid
    np.testing.assert_array_equal(loaded.displacements, field.displacements)
    bodies = PolyrigidMotion(
        np.arange(3.0), np.tile(np.eye(4), (3, 2, 1, 1)), field.grid, np.full((2, 2, 3, 4), 0.5)
    )
    save_motion(tmp_path / "b.npz", bodies)
    loaded = load_motion(tmp_path / "b.npz")
    assert isinstance(loaded, PolyrigidMotion)
    assert loaded.grid == field.grid
    np.testing.assert_array_equal(loaded.bodies, bodies.bodies)
    np.testing.assert_array_equal(loaded.shares, bodies.shares)


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 broken"])
def test_what_is_no_motion_file_is_refused(tmp_path, content):
    (tmp_path / "m.npz").write_bytes(content)
    with pytest.raises(LegsimError, match=r"m\.npz: is not a motion file"):
        load_motion(tmp_path / "m.npz")


@pytest.mark.parametrize("name", ["times", "grid_center", "displacements"])
def test_a_member_that_is_no_array_is_refused(tmp_path, rng, name):
    """Of a damaged archive NumPy gives its bytes."""
    grid = VolumeGrid((2, 3, 4), (0.1, 0.1, 0.1), (0.0, 0.0, 0.0))
    save_motion(
        tmp_path / "m.npz", FieldMotion(np.arange(3.0), grid, rng.normal(size=(3, 2, 3, 4, 3)))
    )
    with (
        zipfile.ZipFile(tmp_path / "m.npz") as whole,
        zipfile.ZipFile(tmp_path / "b.npz", "w") as broken,
    ):
        for member in whole.namelist():
            data = whole.read(member)
            broken.writestr(member, b"#" + data[1:] if member == f"{name}.npy" else data)
    with pytest.raises(LegsimError, match=f"its {name} is no array"):
        load_motion(tmp_path / "b.npz")
