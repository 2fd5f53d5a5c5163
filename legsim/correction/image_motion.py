"""A rigid motion from sharpness, coarse to fine, calibrated, and held against its own error.

1. The entropy of a coarse box is minimized, then that of a fine one. The part of its slopes that
   tells scenes apart which look the same is left out.
2. Calibration: the criterion is not stationary where the motion is right. What it pulls a
   reprojection of the current volume by, whose motion is known, is subtracted, and the descent goes
   on.
3. What is found is followed where the images see more of it than of its errors.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.correction import image_criterion, reprojection
from legsim.correction.fused import discerned
from legsim.correction.image_criterion import COARSE, FINE, FocusScale
from legsim.correction.image_fit import ImageProblem, PathModel, fitted, sharpened, similarity_part
from legsim.correction.method import Correction, Scan
from legsim.correction.path_measurements import StandingFoot, StandingPrior
from legsim.correction.smoother import SmoothedPath
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import Projections
from legsim.opencl.device import Device
from legsim.reconstruction.field_of_view import pixel_at_isocenter

_FLOOR_PX = 0.25
"""pixels of the criterion's own error: that of the trials, whose pixels were 0.8 mm"""


_SURE = 20_000.0
"""weight of a nat near the end, where the optimum is found: priors alone hold back the rest"""


@dataclass(frozen=True, slots=True)
class FocusRound:
    """One descent, with what the criterion itself pulls by taken from where it begins."""

    scale: FocusScale
    steps: int
    """of L-BFGS, or at most of Newton"""
    calibrated: bool = False
    """whether a reprojection says what the criterion pulls by"""
    newton: bool = False
    """whether the criterion's curvature is measured"""
    weight: float = 4000.0
    """of a nat of entropy against the priors' standard deviations"""


@dataclass(frozen=True, slots=True)
class FocusPlan:
    """How a descent goes on."""

    rounds: tuple[FocusRound, ...] = (
        *(FocusRound(COARSE, 12), FocusRound(COARSE, 12)),
        *(FocusRound(FINE, 15), FocusRound(FINE, 5, newton=True, weight=_SURE)),
        FocusRound(FINE, 5, calibrated=True, newton=True, weight=_SURE),
    )
    floor: float = 0.2e-3
    """m at the isocenter: the criterion's own error, as in trials (docs/fusion.md); a quarter of a
    pixel where pixels are larger than theirs

    No covariance has it.
    """


def followed(
    name: str,
    scan: Scan,
    model: PathModel,
    errors: FloatArray,
    standing: StandingPrior,
    device: Device,
    *,
    foot: StandingFoot | None = None,
    below: bool = True,
    plan: FocusPlan | None = None,
) -> Correction:
    """The motion of the leg's part below (or above) the knee, from ``errors`` on, or none.

    Raises:
        LegsimError: there is no leg in the isocenter, or a plan without a round.
    """
    plan = plan if plan is not None else FocusPlan()
    if not plan.rounds:
        raise LegsimError("a FocusPlan needs a round; give one")
    images = image_criterion.binned(scan.projections)
    problem = None
    for step in plan.rounds:
        errors, problem = _descended(
            errors, problem, step, model, standing, foot, images, device, below
        )
    assert problem is not None
    return _judged(name, scan, plan, errors, problem)


def _descended(
    errors: FloatArray,
    last: ImageProblem | None,
    step: FocusRound,
    model: PathModel,
    standing: StandingPrior,
    foot: StandingFoot | None,
    images: Projections,
    device: Device,
    below: bool,
) -> tuple[FloatArray, ImageProblem]:
    """Errors after a round, and its problem."""
    motion = model.path(errors).motion()
    focus = None if last is None else last.sharpness
    if focus is None or step.scale != focus.scale:
        focus = image_criterion.focus(images, motion, step.scale, device, below=below)
    pull = np.zeros_like(motion)
    if step.calibrated:
        _, pull = focus.of(reprojection.reprojected(images, motion, device))(motion)
    # what is left must not prefer one of the scenes that look the same
    rest = focus(motion)[1] - pull
    pull = pull + similarity_part(rest, motion, images.geometry, focus.middle)
    problem = ImageProblem(model, focus, standing, images.geometry, step.weight, pull, foot)
    descend = sharpened if step.newton else fitted
    return descend(problem, errors, step.steps).errors, problem


def _judged(
    name: str, scan: Scan, plan: FocusPlan, errors: FloatArray, problem: ImageProblem
) -> Correction:
    """What was found, or none where it may be no larger than its error."""
    path, geometry, focus = problem.model.path(errors), problem.geometry, problem.sharpness
    covariance = cho_solve(cho_factor(problem.curvature(errors)), np.eye(len(errors)))
    found = SmoothedPath(
        geometry.times, path, errors, covariance, np.zeros((0, 3)), float("nan"), True
    )
    motion_px, spread_px = found.seen_motion(geometry, problem.standing.points)
    floor_px = max(plan.floor / pixel_at_isocenter(geometry), _FLOOR_PX)
    error_px = float(np.hypot(spread_px, floor_px))
    still = np.broadcast_to(np.eye(4), (len(geometry), 4, 4))
    before, after = focus(still)[0], focus(path.motion())[0]
    said = (
        f"{name}: the entropy of the gradient is {before:.4f} without and {after:.4f} with the "
        f"motion that was found; the images see {motion_px:.2g} px RMS of it, and should see "
        f"{error_px:.2g} px of its errors"
    )
    if discerned(motion_px, error_px) and after < before:
        return Correction(name, scan.projections, found.motion, notes=(f"{said}.",))
    left = f"{said}: the data do not determine it, and the scan is left as it is."
    return Correction(name, scan.projections, RigidMotion.identity(scan.times), notes=(left,))
