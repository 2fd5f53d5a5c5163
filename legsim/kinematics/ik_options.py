"""Options of inverse kinematics: what decides a coordinate beside the markers, and tolerances."""

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class CoordinatePrior:
    """A coordinate is pulled to a value: adds ``weight * (coordinate - value)^2`` to the sum over
    the markers.
    """

    coordinate: str
    weight: float
    """m^2/rad^2: (marker error / coordinate's spread)^2"""
    value: float = 0.0
    """rad"""


def _default_priors() -> tuple[CoordinatePrior, ...]:
    # 5 mm of marker error against 10 degrees of spread: decides hip rotation when the knee is
    # straight, hardly counts when it is bent
    weak = (("hip_rotation", 8e-4), ("subtalar_angle", 1e-7), ("mtp_angle", 1e-7))
    return tuple(
        CoordinatePrior(f"{name}_{side}", weight) for name, weight in weak for side in "rl"
    )


@dataclass(frozen=True, slots=True)
class IkOptions:
    """How markers become coordinates."""

    priors: tuple[CoordinatePrior, ...] = field(default_factory=_default_priors)
    """hip rotation toward neutral, toes straight; subtalar so weakly that the flat foot decides"""
    flat_foot_weight: float = 1e-5
    """m^2: of the squared horizontal part of each foot's upright axis; where no marker sits on the
    foot it stands flat on the floor
    """
    tolerance: float = 1e-9
    """m: converged when no free coordinate's gradient, over the root of its own curvature, exceeds
    this
    """
    max_iterations: int = 200
    """of one frame; a frame that has not converged by then is counted in the report"""
    strides: tuple[int, ...] = (64, 8, 1)
    """frames between those solved first, from scratch; then ever closer ones, each started between
    solved neighbors
    """
