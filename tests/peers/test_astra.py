"""ASTRA's own vectors of its cone geometry, beside the same scan made here."""

import numpy as np
import pytest

from legsim.geometry import files
from legsim.geometry.cone_beam import ConeBeamGeometry

pytestmark = pytest.mark.peer
astra = pytest.importorskip("astra")


def test_astras_cone_geometry_is_a_circular_scan(tmp_path, agree):
    """ASTRA's source starts at (0, -500, 0) and turns anticlockwise about z, rows along z."""
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    cone = astra.create_proj_geom("cone", 0.4, 0.4, 48, 62, angles, 500.0, 300.0)
    np.save(tmp_path / "v.npy", astra.geom_2vec(cone)["Vectors"])
    found = files.read_geometry(tmp_path / "v.npy", columns=62, rows=48, up="z")
    assert found.format == "astra"
    # z up becomes y up by (x, y, z) -> (x, z, -y): the source starts at (0, 0, 500) and turns on
    # towards +x
    expected = ConeBeamGeometry.circular(
        times=np.arange(12) / 31,
        angles=angles,
        source_isocenter=0.5,
        source_detector=0.8,
        shape_vu=(48, 62),
        pixel_pitch=0.4e-3,
    )
    away = np.abs(found.geometry.matrices - expected.matrices).max()
    agree("matrices of a cone geometry", "ASTRA", away / np.abs(expected.matrices).max(), 1e-9, "1")
