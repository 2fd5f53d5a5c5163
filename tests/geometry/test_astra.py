"""ASTRA's vectors: points project where its documentation says, and no matrix is taken for them."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry import astra, files
from legsim.geometry._file_parts import Given
from tests.geometry.test_files import circular, corrected


def pixel_of(vectors, shape_vu, point):
    """(u, v) by hand: where the line from the source through a point meets the detector."""
    source, middle, u, v = vectors.reshape(4, 3)
    along = np.linalg.solve(np.stack([u, v, source - point], -1), source - middle)
    return along[:2] + 0.5 * (np.array(shape_vu[::-1]) - 1)


def vectors(views=6):
    """A scan about z, as ASTRA's examples make it: v along z, u along the turning."""
    angles = np.linspace(0, 4, views)
    zero, one = 0 * angles, 0 * angles + 1
    s, c = np.sin(angles), np.cos(angles)
    return np.stack(
        [
            *(500 * s, -500 * c, zero),
            *(-300 * s + 3, 300 * c, zero + 7),
            *(0.4 * c, 0.4 * s, zero),
            *(zero, zero, 0.3 * one),
        ],
        -1,
    )


def test_points_project_as_by_hand():
    geometry = astra.geometry("v.npy", vectors(), Given((48, 62)))
    assert geometry.pixel_pitch == pytest.approx(0.4e-3)
    assert geometry.row_pitch() == pytest.approx(0.3e-3)
    for point in np.random.default_rng(0).uniform(-50, 50, (9, 3)):
        pixels, depths = geometry.project(1e-3 * point[None])
        assert (depths > 0).all()
        expected = [pixel_of(row, (48, 62), point) for row in vectors()]
        np.testing.assert_allclose(pixels[:, 0], expected, atol=1e-8)


def test_lengths_in_pixels_become_mm_by_the_pixels_size():
    by_pixels = astra.geometry("v.npy", vectors() / 0.4, Given((48, 62), (0.4, 0.3)))
    in_mm = astra.geometry("v.npy", vectors(), Given((48, 62)))
    np.testing.assert_allclose(by_pixels.matrices, in_mm.matrices, rtol=1e-9, atol=1e-9)
    with pytest.raises(LegsimError, match=r"0\.75 times as high as wide"):
        astra.geometry("v.npy", vectors(), Given((48, 62), (0.4, 0.4)))


@pytest.mark.parametrize("geometry", [circular(), corrected(), corrected().rows_turned()])
def test_vectors_are_recognized_and_matrices_are_not(tmp_path, geometry):
    assert astra.looks_like_vectors(astra.vectors_of(geometry))
    assert not astra.looks_like_vectors((geometry.matrices * [1, 1, 1, 1e3]).reshape(-1, 12))
    files.save_geometry(tmp_path / "g.npy", geometry, format="astra")
    found = files.read_geometry(tmp_path / "g.npy", columns=62, rows=48)
    assert "read as ASTRA's cone_vec" in found.notes[0]


def test_a_single_matrix_is_not_taken_for_vectors():
    """Views are taken one by one, which a coincidence could pass most easily."""
    for view in corrected().matrices:
        assert not astra.looks_like_vectors((view * [1, 1, 1, 1e3]).reshape(1, 12))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda v: np.where(np.arange(12) == 3, np.nan, v),
            r"view 0\): holds numbers that are not",
        ),
        (lambda v: v * np.where(np.arange(12) > 8, 0, 1), "its pixels are"),
        (lambda v: v * (1 + np.eye(6, 12, k=6)), "in most views 0.4"),
        (lambda v: np.hstack([v[:, :3], v[:, :3], v[:, 6:]]), "its plane holds the source"),
    ],
)
def test_impossible_vectors_are_refused(change, message):
    with pytest.raises(LegsimError, match=message):
        astra.geometry("v.npy", change(vectors()), Given((48, 62)))
