"""A rigid motion from sharpness, coarse to fine, calibrated, and held against its own error.

1. The entropy of a coarse box is minimized, then that of a fine one.
2. Calibration: the criterion is not stationary where the motion is right. What it pulls a
   reprojection of the current volume by, whose motion is known, is subtracted, and the descent goes
   on. A few rounds.
3. What is found is followed where the images see more of it than of its errors.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from legsim.core.values import FloatArray
from legsim.correction import image_criterion, reprojection
from legsim.correction.image_criterion import COARSE, FINE
from legsim.correction.image_fit import ImageProblem, PathModel, fitted
from legsim.correction.method import Correction, Scan
from legsim.correction.smoother import SmoothedPath, StandingPrior
from legsim.deformation.models import RigidMotion
from legsim.opencl.device import Device

_DISCERNED = float(np.sqrt(2))
"""times its error that a motion must be seen by to be followed (docs/methods.md)"""


@dataclass(frozen=True, slots=True)
class FocusSteps:
    """How long a descent goes on."""

    weight: float = 4000.0
    """of a nat of entropy against the priors' standard deviations"""
    coarse: int = 30
    fine: int = 30
    """steps of L-BFGS before calibration"""
    rounds: int = 2
    """of calibration"""
    each: int = 15
    """steps of each round"""
    floor_px: float = 0.25
    """px of 0.8 mm at the isocenter: what the criterion's error after calibration is reckoned with

    Measured in trials (docs/methods.md); no covariance knows of it.
    """


def followed(
    name: str,
    scan: Scan,
    model: PathModel,
    errors: FloatArray,
    standing: StandingPrior,
    device: Device,
    *,
    below: bool = True,
    steps: FocusSteps | None = None,
) -> Correction:
    """The motion of the leg's part below (or above) the knee, from ``errors`` on, or none.

    Raises:
        LegsimError: there is no leg in the isocenter.
    """
    steps = steps if steps is not None else FocusSteps()
    images = image_criterion.binned(scan.projections)
    geometry = images.geometry
    still = np.broadcast_to(np.eye(4), (len(geometry), 4, 4))

    def problem(focus: image_criterion.Focus, pull: FloatArray | None = None) -> ImageProblem:
        return ImageProblem(model, focus, standing, geometry, steps.weight, pull)

    focus = image_criterion.focus(images, model.path(errors).motion(), COARSE, device, below=below)
    errors = fitted(problem(focus), errors, steps.coarse).errors
    focus = image_criterion.focus(images, model.path(errors).motion(), FINE, device, below=below)
    pull = None
    errors = fitted(problem(focus), errors, steps.fine).errors
    for _ in range(steps.rounds):
        motion = model.path(errors).motion()
        again = reprojection.reprojected(images, motion, device)
        _, pull = focus.of(again)(motion)
        errors = fitted(problem(focus, pull), errors, steps.each).errors
    last = problem(focus, pull)
    path = model.path(errors)
    covariance = cho_solve(cho_factor(last.curvature(errors)), np.eye(model.size))
    before, after = focus(still)[0], focus(path.motion())[0]
    found = SmoothedPath(
        geometry.times, path, errors, covariance, np.zeros((0, 3)), float("nan"), True
    )
    motion_px, spread_px = found.seen_motion(geometry, standing.points)
    error_px = float(np.hypot(spread_px, steps.floor_px))
    said = (
        f"{name}: entropy of the gradient {before:.4f} without and {after:.4f} with the motion "
        f"that was found; the images see {motion_px:.2g} px RMS of it, and should see "
        f"{error_px:.2g} px of its errors"
    )
    if motion_px > _DISCERNED * error_px and after < before:
        return Correction(name, scan.projections, found.motion, notes=(f"{said}.",))
    left = f"{said}: the data do not determine it, and the scan is left as it is."
    return Correction(name, scan.projections, RigidMotion.identity(scan.times), notes=(left,))
