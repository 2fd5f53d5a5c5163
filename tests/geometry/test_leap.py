"""LEAP's parameter files: pixels stand where LEAP's formulas put them."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry import files

CONE = """# CT volume parameters
numX = 512
voxelWidth = 5.1e-01

# CT geometry parameters
geometry = cone
numAngles = 4
numRows = 40
numCols = 60
pixelHeight = 8.0e-01
pixelWidth = 6.0e-01
centerRow = 17.5
centerCol = 33.0
angularRange = 2.0e+02
sod = 1.1e+03
sdd = 1.4e+03
tau = 3.0
helicalPitch = 0.000000e+00
tiltAngle = 2.5
"""

MODULAR = """geometry = modular
numAngles = 2
numRows = 40
numCols = 60
pixelHeight = 0.8
pixelWidth = 0.6
sourcePositions = 1000, 0, 0, 0, 1000, 5
moduleCenters = -400, 10, 0, 1, -400, 0
rowVectors = 0, 0, 1, 0, 0, 1
colVectors = 0, 1, 0, -1, 0, 0
"""


def read(tmp_path, text, name="a.txt", **given):
    (tmp_path / name).write_text(text)
    return files.read_geometry(tmp_path / name, up="z", **given)


def seen(found, point_mm):
    """(v, 2) column and row of a point in the file's axes, of which z is up."""
    x, y, z = point_mm
    return found.geometry.project(1e-3 * np.array([[x, z, -y]]))[0][:, 0]


def leaps(point_mm, degrees):
    """(column, row) of a point by LEAP's own u and v of its documentation, tilted as its detector.

    u = (x . p + tau) / (R - x . t) and v = z / (R - x . t) at phi - 90 degrees.
    """
    phi = np.radians(degrees - 90)
    t, p = np.array([np.cos(phi), np.sin(phi), 0]), np.array([-np.sin(phi), np.cos(phi), 0])
    depth = 1100 - point_mm @ t
    u, v = (point_mm @ p + 3) / depth, point_mm[2] / depth
    tilt = np.radians(2.5)
    along = np.array([[np.cos(tilt), np.sin(tilt)], [-np.sin(tilt), np.cos(tilt)]]) @ (u, v)
    return 1400 * along / (0.6, 0.8) + (33.0, 17.5)


def test_a_cone_is_read_as_leap_projects_it(tmp_path):
    found = read(tmp_path, CONE)
    assert (found.format, found.geometry.shape_vu, len(found.geometry)) == ("leap", (40, 60), 4)
    assert found.geometry.pixel_pitch == pytest.approx(0.6e-3)
    for point in (np.zeros(3), np.array([5.0, -3, 2]), np.array([-20.0, 40, 7])):
        expected = [leaps(point, 50 * k) for k in range(4)]
        np.testing.assert_allclose(seen(found, point), expected, atol=1e-9)


def test_angles_one_by_one_are_read(tmp_path):
    listed = CONE.replace("angularRange = 2.0e+02", "phis =  0.0, 5.0e+01, 1.0e+02,1.5e+02")
    np.testing.assert_allclose(
        read(tmp_path, listed).geometry.matrices, read(tmp_path, CONE).geometry.matrices, rtol=1e-12
    )


def test_modules_stand_where_their_vectors_say(tmp_path):
    found = read(tmp_path, MODULAR)
    sources = 1e3 * found.geometry.sources()
    np.testing.assert_allclose(sources, [[1000, 0, 0], [0, 5, -1000]], atol=1e-9)
    # the first module's middle is 10 mm along its columns from the origin's ray
    np.testing.assert_allclose(seen(found, (0, 0, 0))[0], (29.5 - 10 / 0.6, 19.5), atol=1e-9)


def test_names_of_older_files_are_known(tmp_path):
    older = (
        "proj_geometry = cone\nproj_nangles = 4\nproj_nrows = 40\nproj_ncols = 60\n"
        "proj_pheight = 0.8\nproj_pwidth = 0.6\nproj_crow = 17.5\nproj_ccol = 33\n"
        "proj_arange = 200\nproj_sod = 1100\nproj_sdd = 1400\nproj_tau = 3\n"
        "proj_tiltAngle = 2.5\n"
    )
    np.testing.assert_allclose(
        read(tmp_path, older).geometry.matrices, read(tmp_path, CONE).geometry.matrices, rtol=1e-12
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("geometry = cone", "geometry = fan", "the beam is 'fan'; only cone beams"),
        ("tau = 3.0", "tau = 3.0\ndetectorType = curved", "the detector is curved"),
        ("0.000000e+00", "1.5", r"helicalPitch\): the source goes along a helix"),
        ("numRows = 40\n", "", "lacks numRows"),
        ("sod = 1.1e+03", "sod = far", r"sod\): is not of numbers"),
        ("numCols = 60", "numCols = 0", "is not positive"),
        ("angularRange = 2.0e+02", "phis = 1, 2, 3", r"phis\): has 3 numbers; expected 4"),
        ("sdd = 1.4e+03", "sdd = nan", r"sdd\): is too large|not finite"),
        ("sdd = 1.4e+03", "sdd = 0", "its plane holds the source"),
    ],
)
def test_what_is_no_flat_cone_beam_is_refused(tmp_path, old, new, said):
    with pytest.raises(LegsimError, match=said):
        read(tmp_path, CONE.replace(old, new))


def test_another_detector_than_the_images_is_refused(tmp_path):
    with pytest.raises(LegsimError, match="says 60 columns and 40 rows, not 61 and 40"):
        read(tmp_path, CONE, columns=61, rows=40)
