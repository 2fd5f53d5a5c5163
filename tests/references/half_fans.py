"""Scans whose detector stands to one side."""

from dataclasses import replace

import numpy as np

from legsim.geometry.cone_beam import ConeBeamGeometry

COLUMNS = 90


def half_fan(
    shift: float, *, span_deg: float = 360.0, views: int = 180, mirrored: bool = False
) -> ConeBeamGeometry:
    """A detector moved by ``shift`` columns towards higher ones, so that the axis is seen ``shift``
    columns before its middle.
    """
    base = ConeBeamGeometry.circular(
        times=np.arange(views) * 1.0,
        angles=np.radians(np.linspace(0, span_deg, views, endpoint=False)),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(80, COLUMNS),
        pixel_pitch=3.2e-3,
    )
    flip = np.array([[-1.0, 0, COLUMNS - 1], [0, 1, 0], [0, 0, 1]]) if mirrored else np.eye(3)
    return replace(
        base, matrices=flip @ np.array([[1.0, 0, -shift], [0, 1, 0], [0, 0, 1]]) @ base.matrices
    )


def shifted_by_view(geometry: ConeBeamGeometry, columns: np.ndarray) -> ConeBeamGeometry:
    """The detector moved by columns (v,) more, towards higher ones."""
    sideways = np.repeat(np.eye(3)[None], len(geometry), 0)
    sideways[:, 0, 2] = -columns
    return replace(geometry, matrices=sideways @ geometry.matrices)
