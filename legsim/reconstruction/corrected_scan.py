"""What reconstructions take: projections, or a correction that brings its own motion."""

from typing import Protocol

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.deformation.models import Motion, RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections

_RIGID = 1e-3
"""by which elements of a rigid transform may be off: numbers of files are rounded"""


class CorrectedScan(Protocol):
    """Images and the motion to follow, such as a :class:`legsim.correction.Correction`."""

    @property
    def projections(self) -> Projections:
        """Line integrals under the scanner's geometry."""
        ...

    @property
    def motion(self) -> Motion | None:
        """How the object moved; None: voxels stay where they are."""
        ...


def images_and_motion(
    scan: Projections | CorrectedScan, motion: Motion | None
) -> tuple[Projections, Motion | None]:
    """Images to reconstruct and the motion to follow.

    Raises:
        LegsimError: a corrected scan comes with a second motion, ``scan`` is something else,
            images hold values that are not finite, a motion has another number of views, or a
            rigid motion is none.
    """
    if isinstance(scan, Projections):
        _check(scan, motion)
        return scan, motion
    images = getattr(scan, "projections", None)
    if not isinstance(images, Projections) or not hasattr(scan, "motion"):
        raise LegsimError(
            f"expected Projections, or a Correction with projections and motion, not "
            f"{type(scan).__name__}"
        )
    if motion is not None:
        raise LegsimError(
            "the correction has a motion of its own; leave out motion=, or give the correction's "
            "projections alone"
        )
    _check(images, scan.motion)
    return images, scan.motion


def check_views(geometry: ConeBeamGeometry, motion: Motion | None) -> None:
    """Refuses a motion of another scan.

    Raises:
        LegsimError: it has another number of views.
    """
    if motion is not None and len(motion.times) != len(geometry):
        raise LegsimError(
            f"the motion has {len(motion.times)} transforms for {len(geometry)} views; expected "
            "one per view"
        )


def _check(projections: Projections, motion: Motion | None) -> None:
    """Refuses values that would spread over the whole volume, and motions that change shapes."""
    if not len(projections.geometry):
        raise LegsimError("the projections hold no view; there is nothing to reconstruct from")
    check_views(projections.geometry, motion)
    for view, image in enumerate(projections.line_integrals):
        # a sum is finite where all values are: line integrals are far from overflow
        if not np.isfinite(image.sum(dtype=np.float64)):
            raise LegsimError(
                f"view {view} of the projections holds values that are not finite numbers; replace "
                "them before reconstructing"
            )
    if isinstance(motion, RigidMotion):
        off = _off_rigid(motion.moved_from_reference)
        if off.max() > _RIGID:
            raise LegsimError(
                f"RigidMotion.moved_from_reference is not rigid in view {int(off.argmax())}: give "
                "a rotation and a translation in m, the last row 0, 0, 0, 1"
            )


def _off_rigid(matrices: FloatArray) -> FloatArray:
    """(v,) how far matrices (v, 4, 4) are from rotations with a translation."""
    turned = matrices[:, :3, :3]
    off = np.abs(np.swapaxes(turned, -1, -2) @ turned - np.eye(3)).max((1, 2))
    off = np.maximum(off, np.abs(matrices[:, 3] - [0, 0, 0, 1]).max(1))
    return np.where(np.linalg.det(turned) > 0, off, np.inf)
