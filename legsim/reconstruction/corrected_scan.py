"""What reconstructions take: projections, or a correction that brings its own motion."""

from typing import Protocol

import numpy as np

from legsim.core.errors import LegsimError
from legsim.deformation.models import Motion
from legsim.geometry.cone_beam import Projections


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
        LegsimError: a corrected scan comes with a second motion, ``scan`` is something else, or
            images hold values that are not finite.
    """
    if isinstance(scan, Projections):
        _check_finite(scan)
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
    _check_finite(images)
    return images, scan.motion


def _check_finite(projections: Projections) -> None:
    """One such value would spread over the whole volume."""
    for view, image in enumerate(projections.line_integrals):
        # a sum is finite where all values are: line integrals are far from overflow
        if not np.isfinite(image.sum(dtype=np.float64)):
            raise LegsimError(
                f"view {view} of the projections holds values that are not finite numbers; replace "
                "them before reconstructing"
            )
