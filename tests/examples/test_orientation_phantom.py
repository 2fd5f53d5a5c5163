"""The L reads as an L in the first view, drawn with the origin below, and in slices seen from
+z.
"""

import numpy as np

from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import VolumeGrid
from legsim.phantom import raster, voxelize
from legsim.scan import projector
from tests.examples import orientation_phantom

CENTER = (0.1, 0.5, -0.03)


def test_the_surfaces_are_closed_and_face_outward():
    for part in orientation_phantom.phantom(CENTER).parts:
        raster.require_closed(part)
        a, b, c = np.moveaxis((part.vertices - CENTER)[part.triangles], 1, 0)
        assert np.einsum("ti,ti->", a, np.cross(b, c)) > 0


def test_the_first_view_shows_an_l(device):
    geometry = ConeBeamGeometry.circular(
        times=[0, 1],
        angles=[0, np.pi],
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(60, 60),
        pixel_pitch=2.5e-3,
        isocenter=CENTER,
    )
    front, back = projector.project(
        orientation_phantom.phantom(CENTER), geometry, device
    ).line_integrals
    # above the block's water, the letter: (rows upwards, columns to the right) as a picture with
    # the origin below
    letter = front > 1.7
    up, right = np.nonzero(letter)
    assert letter[up.max(), : right.max()].any()
    assert right[up > 35].max() < 30, "the stroke is on the left"
    assert right[up < 20].max() > 35, "the foot reaches to the right"
    assert np.nonzero(back > 1.7)[1][np.nonzero(back > 1.7)[0] > 35].min() > 30, (
        "mirrored from behind"
    )


def test_the_bead_is_in_front(device):
    labels = voxelize.labels(
        orientation_phantom.phantom(CENTER), VolumeGrid.cubic(41, 2.5e-3, CENTER), device
    )
    z, y, x = np.nonzero(labels == 3)
    assert z.mean() > 25
    assert y.mean() < 15
    assert x.mean() < 17
