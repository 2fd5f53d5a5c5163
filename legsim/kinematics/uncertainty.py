"""How well a recording tells each coordinate: standard deviations from the markers' errors, their
places, and the priors.

At a frame the poses' covariance is e^2 A^-1 + F C F', with e the error of a marker, A the
Gauss-Newton matrix of inverse kinematics (priors included), C the covariance of the person's
parameters and F how the pose follows them. What neither markers nor priors tell lies anywhere in
the range that people have.
"""

import numpy as np

from legsim.core.values import FloatArray, frozen
from legsim.kinematics._ik_problem import Problem
from legsim.kinematics._registration_model import Parameters, Person, PersonModel, joint_blocks
from legsim.kinematics.leg import Leg
from legsim.kinematics.registration import MARKER_ERROR, Registration

_FRAMES = 20

_PEOPLES_RANGE_DEG = {"ankle_angle": 65.0, "subtalar_angle": 40.0, "mtp_angle": 90.0}
"""width: ankle -45 to 20, subtalar 15 out to 25 in, toes -30 to 60 (Kapandji, The physiology of the
joints, vol. 2); the model's limits are wider
"""


def coordinate_spread(
    problem: Problem, found: Registration | None, values: FloatArray, seen: np.ndarray
) -> FloatArray:
    """Standard deviation (c,) of each coordinate, rad and m, root mean square over some twenty
    frames.

    Args:
        problem: of inverse kinematics.
        found: by registration; None where the person stayed as scaled, so that the places' own
            priors count.
        values: (n, c) the solution.
        seen: (n, m) which markers each frame shows.
    """
    leg, sites = problem.leg, problem.sites
    some = np.unique(np.linspace(0, len(values) - 1, _FRAMES).astype(int))
    weights, values = seen[some] * sites.weights, values[some]
    measured = np.zeros((*weights.shape, 3))
    curvature = problem.at(values, measured, weights, np.zeros(len(some), bool)).curvature
    curvature = curvature + problem.floor()
    error = MARKER_ERROR if found is None else found.error
    own = error**2 * np.linalg.inv(curvature)
    model: Parameters = PersonModel(leg, sites)
    if found is None:
        theta, covariance = np.zeros(model.size), np.linalg.inv(model.precision)
    else:
        columns = found.model.columns_of(sites.names)
        model, theta = found.model.only(sites.names), found.theta[columns]
        covariance = found.covariance[np.ix_(columns, columns)]
    person = Person(leg, sites, np.zeros(2), theta)
    mixed, _, _ = joint_blocks(model, person, problem, values, measured, weights)
    follow = np.linalg.solve(curvature, mixed)
    variance = np.einsum("ncc->nc", own) + np.einsum("ncp,pq,ncq->nc", follow, covariance, follow)
    spread = np.sqrt(variance.mean(0))
    return frozen("spread", np.minimum(spread, _widest(leg)), (values.shape[1],))


def _widest(leg: Leg) -> FloatArray:
    """Standard deviation (c,) of a coordinate that lies anywhere in its range."""
    width = np.ptp(leg.coordinate_ranges, axis=1)
    for k, name in enumerate(leg.coordinate_names):
        kind = name.removesuffix("_r").removesuffix("_l")
        if kind in _PEOPLES_RANGE_DEG:
            width[k] = np.radians(_PEOPLES_RANGE_DEG[kind])
    width[: leg.pelvis_coordinates] = np.inf
    return width / np.sqrt(12)
