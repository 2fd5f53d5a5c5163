"""Motion undone in the projections: images deformed so that tracked points do not move.

Maier et al. 2022, section 2.6.2. The control points at rest and moved are projected with each
view's own matrix; the pixel at v of the corrected image is what the recorded image shows at f(v)
(see :mod:`legsim.deformation.moving_least_squares` for f). Depth is lost: points along one ray that
move differently get the same shift.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from legsim.deformation.models import ControlPointMotion, image_points
from legsim.geometry.cone_beam import Projections
from legsim.opencl.device import Device

_BATCH_BYTES = 1 << 27


def warp_images(
    projections: Projections,
    motion: ControlPointMotion,
    device: Device,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Projections:
    """Warps the images as if the control points had stayed at rest, under the same geometry.

    Any number of control points. Read by cubic convolution (Keys 1981); where f(v) lies outside,
    the border pixel is repeated.

    Raises:
        LegsimError: as :func:`image_points`.
    """
    resting, moved = image_points(projections.geometry, motion)
    points = np.concatenate([resting, moved - resting], -1).astype(np.float32)
    views, rows, columns = projections.line_integrals.shape
    kernel = device.kernel(
        "warp_mls", "warp_images.cl", ROWS=rows, COLUMNS=columns, COUNT=points.shape[1]
    )
    corrected = np.empty_like(projections.line_integrals)
    batch = max(1, _BATCH_BYTES // (4 * rows * columns))
    for start in range(0, views, batch):
        stop = min(start + batch, views)
        target = device.zeros((stop - start) * rows * columns)
        source, controls = (
            device.upload(projections.line_integrals[start:stop]),
            device.upload(points[start:stop]),
        )
        kernel(device.queue, (columns, rows, stop - start), None, source, controls, target)
        device.download(target, corrected[start:stop])
        if progress is not None:
            progress(stop, views)
    return replace(projections, line_integrals=corrected)
