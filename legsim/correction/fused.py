"""Corrections by a consumer sensor whose drift is found: the person stands, metal is seen.

All follow the segment that carries one sensor, as :class:`legsim.correction.rigid.Rigid` does, but
along the path that :mod:`legsim.correction.smoother` estimates. Where the data do not determine a
motion that the images would see, they say so and leave the scan as it is.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import positive
from legsim.correction.bead_scan import BeadScan, shadows_of
from legsim.correction.error_state import CLOCK_REACH, ErrorState, error_state
from legsim.correction.method import Correction, Scan
from legsim.correction.path_measurements import (
    BeadShadows,
    FiducialShadows,
    StandingFoot,
    StandingPrior,
)
from legsim.correction.path_problem import DivergedError
from legsim.correction.rough_start import StartErrors
from legsim.correction.smoother import SmoothedPath, smooth
from legsim.deformation.models import RigidMotion
from legsim.imu.catalogue import load_sensor
from legsim.imu.errors import SensorErrors

DISCERNED = float(np.sqrt(2))
"""times its standard deviation that a motion must be seen by to be followed

What is found of a motion m with an error e has m^2 + e^2 on average. Following it leaves e, not
following it leaves m.
"""


_OVER_FOOT, _TURN_ARM = 2.0, 0.1
"""times the spread of a knee over a foot that stands, and m beside it at which this is its turn: 4
mm and 2.3 deg. A knee that was to stay within 2 mm was pressed there when it swayed by more, and
the stated error did not say so.
"""

_UNLIKELY = 5.0
"""standard deviations of an error of which nothing seen says that it is there"""

_SHANK, _UPRIGHT = (0.18, 0.65), 0.5
"""m from a knee to its ankle, from a small child's to a very tall person's, and its share that
is vertical in the deepest stance
"""

_FAR = 5.0
"""times its stated error that a shadow may be from the path before it is doubted"""


def discerned(seen_px: float, error_px: float) -> bool:
    """Whether following a motion that is seen by so much leaves less than leaving it."""
    return seen_px > DISCERNED * error_px


@dataclass(frozen=True, slots=True)
class SensorPriors:
    """What is known of a sensor and its wearer before the scan."""

    errors: SensorErrors = field(default_factory=lambda: load_sensor("bmi160").errors)
    """of the sensor, by its data sheet"""
    start: StartErrors = field(default_factory=StartErrors)
    """how far its start may be off"""
    spread: float = 2e-3
    """m, RMS of each coordinate by which a knee moves while its owner stands through a scan"""
    clock: float = 0.01
    """s, standard deviation of the offset between the clocks; the sensor's own filter delays too"""

    def __post_init__(self) -> None:
        positive("SensorPriors.spread", self.spread)
        positive("SensorPriors.clock", self.clock, zero=True)


@dataclass(frozen=True, slots=True)
class Standing:
    """Rigid motion from one sensor of a person who stands: no image is used.

    Where the ankle is known in the sensor, on a shank, the foot below stands, and a sensor that one
    can buy says how the knee sways. Without it only one that hardly drifts does.

    >>> Standing("shank_l", SensorPriors(load_sensor("icm42688").errors))(scan)
    """

    sensor: str = ""
    """the sensor to follow; empty: the first one of the scan"""
    priors: SensorPriors = field(default_factory=SensorPriors)

    def __call__(self, scan: Scan, /) -> Correction:
        foot, doubted = standing_foot(scan, self.sensor)
        try:
            found = self.path(scan)
        except DivergedError as error:
            return left_as_it_is("standing", scan, error)
        notes = (*doubted, *foot_note(foot, found))
        worst = float(np.abs(found.errors).max())
        if worst < _UNLIKELY:
            return _corrected("standing", scan, found, notes)
        said = (
            f"In doubt: standing: an error of the sensor or of its start is {worst:.1f} times what "
            "its data sheet and the start allow: the signals do not fit a person who stands. The "
            "scan is left as it is. Check the sensor's start and axes, its model, and the place of "
            "the ankle."
        )
        return _at_rest("standing", scan, (*notes, said))

    def path(self, scan: Scan) -> SmoothedPath:
        """The sensor's path with its covariance, whether it will be followed or not.

        Raises:
            DivergedError: no path fits the signals and the start.
        """
        foot, _ = standing_foot(scan, self.sensor)
        stands = _standing(scan, self.priors)
        if foot is not None:
            # the foot holds the place, and the knee's prior the turn about the vertical
            knee = scan.projections.geometry.rotation_center()
            stands = StandingPrior.at(knee, _OVER_FOOT * self.priors.spread, _TURN_ARM)
        state = sensor_state(scan, self.sensor, self.priors, clock=0.0)
        return smooth(state, standing=stands, foot=foot)


@dataclass(frozen=True, slots=True)
class FusedBeads:
    """Rigid motion from one sensor, a person who stands, and shadows of few skin beads.

    >>> FusedBeads(scan.beads(Beads.on_one_side(2)), "shank_l")(scan.seen)
    """

    beads: BeadShadows | BeadScan | Callable[[], BeadShadows | BeadScan]
    """their shadows, or the scan with beads in which they are tracked, or what makes either"""
    sensor: str = ""
    """the sensor to follow, on the segment that the beads are on; empty: the scan's first"""
    priors: SensorPriors = field(default_factory=SensorPriors)

    def __call__(self, scan: Scan, /) -> Correction:
        beads = shadows_of(self.beads() if callable(self.beads) else self.beads)
        state = sensor_state(scan, self.sensor, self.priors, clock=self.priors.clock)
        foot, doubted = standing_foot(scan, self.sensor)
        try:
            found = smooth(
                state,
                standing=_standing(scan, self.priors),
                geometry=scan.projections.geometry,
                beads=beads,
                foot=foot,
            )
        except DivergedError as error:
            return left_as_it_is("fused-beads", scan, error)
        share = float(np.isfinite(beads.pixels).all(-1).mean())
        note = (
            f"{beads.pixels.shape[1]} beads: {100 * share:.0f} % of their shadows were found, "
            f"{found.residual_px:.2f} px RMS from the sensor's path."
        )
        doubts = doubts_of_shadows("fused-beads", found, beads.error_px)
        notes = (note, *doubts, *doubted, *foot_note(foot, found), *_clock_note(state, found))
        return _corrected("fused-beads", scan, found, notes)


@dataclass(frozen=True, slots=True)
class FusedFiducials:
    """Rigid motion from one sensor, a person who stands, and shadows of points in the sensor.

    Their places in the sensor are known, so that they show the sensor itself in every view: its
    turn about the vertical and its place are found too.
    """

    fiducials: FiducialShadows | Callable[[], FiducialShadows]
    """their shadows in all views, or what finds them"""
    sensor: str = ""
    """the sensor that they are in; empty: the scan's first"""
    priors: SensorPriors = field(default_factory=SensorPriors)

    def __call__(self, scan: Scan, /) -> Correction:
        fiducials = self.fiducials() if callable(self.fiducials) else self.fiducials
        if not isinstance(fiducials, FiducialShadows):
            raise LegsimError(
                "fiducials are FiducialShadows(pixels of (view, point, 2), places in the sensor), "
                f"not {type(fiducials).__name__}"
            )
        state = sensor_state(scan, self.sensor, self.priors, clock=self.priors.clock)
        foot, doubted = standing_foot(scan, self.sensor)
        try:
            found = smooth(
                state,
                standing=_standing(scan, self.priors),
                geometry=scan.projections.geometry,
                fiducials=fiducials.enough(),
                foot=foot,
            )
        except DivergedError as error:
            return left_as_it_is("fused-fiducials", scan, error)
        share = float(np.isfinite(fiducials.pixels).all(-1).mean())
        note = (
            f"{fiducials.pixels.shape[1]} fiducials in the sensor: {100 * share:.0f} % of their "
            f"shadows were found, {found.residual_px:.2f} px RMS from the sensor's path."
        )
        doubts = doubts_of_shadows("fused-fiducials", found, fiducials.error_px)
        notes = (note, *doubts, *doubted, *foot_note(foot, found), *_clock_note(state, found))
        return _corrected("fused-fiducials", scan, found, notes)


def left_as_it_is(method: str, scan: Scan, why: DivergedError) -> Correction:
    """No motion, and a note that nothing fits."""
    return _at_rest(method, scan, (f"In doubt: {method}: {why}. The scan is left as it is.",))


def _at_rest(method: str, scan: Scan, notes: tuple[str, ...]) -> Correction:
    return Correction(method, scan.projections, RigidMotion.identity(scan.times), notes=notes)


def sensor_state(scan: Scan, sensor: str, priors: SensorPriors, *, clock: float) -> ErrorState:
    """The errors of one sensor; its clock is taken as known where the recording is too short."""
    name = scan.sensor(sensor)
    times, views = scan.signals.times, scan.times
    beyond = min(views[0] - times[0], times[-1] - views[-1])
    return error_state(
        scan.signals,
        name,
        scan.start(name),
        views,
        priors.errors,
        priors.start,
        clock=clock if beyond > CLOCK_REACH * clock else 0.0,
    )


def _standing(scan: Scan, priors: SensorPriors) -> StandingPrior:
    return StandingPrior.at(scan.projections.geometry.rotation_center(), priors.spread)


def standing_foot(scan: Scan, sensor: str) -> tuple[StandingFoot | None, tuple[str, ...]]:
    """The foot below the sensor that is followed, or why what is given cannot be one; None where no
    ankle is known in that sensor.
    """
    name = scan.sensor(sensor)
    ankle = scan.ankle(name)
    if ankle is None:
        return None, ()
    knee = scan.projections.geometry.rotation_center()
    below = knee - transforms.apply(scan.start(name).world_from_sensor, ankle[None])[0]
    far = float(np.linalg.norm(below))
    if _SHANK[0] < far < _SHANK[1] and below[1] > _UPRIGHT * far:
        return StandingFoot(ankle), ()
    where = "below" if below[1] > 0 else "above"
    return None, (
        f"In doubt: the ankle in sensor {name} is {1e3 * far:.0f} mm from the rotation center at "
        f"the first view, {1e3 * abs(below[1]):.0f} mm {where} it, where no shank has it: its foot "
        "is not held. Check the place of the ankle (millimeters, in the sensor's own axes) and the "
        "sensor's start.",
    )


def doubts_of_shadows(method: str, found: SmoothedPath, error_px: float) -> tuple[str, ...]:
    """A sentence where shadows are nowhere near the path; nothing where they are as stated."""
    if found.residual_px < _FAR * error_px:
        return ()
    return (
        f"In doubt: {method}: the shadows are {found.residual_px:.2g} px RMS from the sensor's "
        f"path, where {error_px:.2g} px along u and v are stated. Check which is which, the order "
        "of the views, and (column, row) of the pixels.",
    )


def foot_note(given: StandingFoot | None, found: SmoothedPath) -> tuple[str, ...]:
    """How still the foot was taken to stand; nothing where its ankle is not known."""
    if given is None or found.foot is None:
        return ()
    ankle = transforms.apply(found.path.poses, given.ankle_sensor[None])[:, 0]
    moved = 1e3 * float(np.sqrt(np.square(ankle - ankle.mean(0)).sum(-1).mean()))
    walk = f"its ankle wanders by {1e3 * found.foot.walk:.2g} mm per root of a second"
    if found.foot.walk > given.walk:
        return (f"The foot does not stand still: {walk}, {moved:.2g} mm RMS in this scan.",)
    return (f"The foot is taken to stand: {walk}, {moved:.2g} mm RMS in this scan.",)


def _clock_note(state: ErrorState, found: SmoothedPath) -> tuple[str, ...]:
    """What was found of the offset between the clocks, and how well; nothing where it is known."""
    if not state.clock_sigma:
        return ()
    offset, spread = (
        1e3 * state.clock_sigma * number
        for number in (found.errors[-1], float(np.sqrt(found.covariance[-1, -1])))
    )
    return (
        f"The sensor's clock is {offset:+.1f} ms ahead of the views', with a standard deviation of "
        f"{spread:.1f} ms (before: {1e3 * state.clock_sigma:.1f} ms); its own filter's delay "
        "counts the other way.",
    )


def _corrected(name: str, scan: Scan, found: SmoothedPath, notes: tuple[str, ...]) -> Correction:
    """The estimate and what images should see of its errors.

    A motion that may be no larger than its error is not followed: that would risk more than it
    undoes.
    """
    geometry = scan.projections.geometry
    points = StandingPrior.at(geometry.rotation_center()).points
    motion_px, error_px = found.seen_motion(geometry, points)
    said = (
        f"{name}: the images see {motion_px:.2g} px RMS of the motion that was found at the knee, "
        f"and should see {error_px:.2g} px of its errors"
    )
    if found.settled and discerned(motion_px, error_px):
        return Correction(name, scan.projections, found.motion, notes=(*notes, f"{said}."))
    why = "its estimate did not settle" if not found.settled else "the data do not determine it"
    left = f"{said}: {why}, and the scan is left as it is."
    return _at_rest(name, scan, (*notes, left))
