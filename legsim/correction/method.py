"""From poses over time to the input of the reconstruction: the interface of all methods.

A user's own method uses the same interface. A method is a function from a :class:`Scan` (everything
a real scanner would have recorded) to a :class:`Correction` (projections and the motion that the
back-projection follows).
"""

import traceback
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.correction.control_points import AttachedPoint
from legsim.deformation.models import ControlPointMotion, Motion
from legsim.geometry.cone_beam import Projections
from legsim.imu.signals import ImuSignals, SensorStart


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """What a scanner with sensors records, and what is known beforehand.

    A method sees nothing else.
    """

    projections: Projections
    signals: ImuSignals
    starts: tuple[SensorStart, ...]
    """pose and velocity of each sensor of ``signals`` at the first view"""
    joints: tuple[tuple[AttachedPoint, ...], ...] = ()
    """hip, knee, ankle and further points of each followed leg, on the sensors that carry them

    Their positions in the sensors are known; empty where they are not.
    """
    ankles: tuple[AttachedPoint, ...] = ()
    """of feet that may stand, on the shanks' sensors, where no leg of ``joints`` has them"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "starts", tuple(self.starts))
        object.__setattr__(self, "joints", tuple(tuple(leg) for leg in self.joints))
        object.__setattr__(self, "ankles", tuple(self.ankles))
        if len(self.starts) != len(self.signals.sensor_names):
            raise LegsimError(
                f"Scan has {len(self.starts)} starts for {len(self.signals.sensor_names)} "
                "sensors; give one each, in order"
            )

    def __repr__(self) -> str:
        sensors = ", ".join(self.signals.sensor_names)
        return (
            f"Scan({len(self.times)} views, sensors {sensors}, joints of {len(self.joints)} legs)"
        )

    @property
    def times(self) -> FloatArray:
        """(v,) s of the views."""
        return self.projections.geometry.times

    def sensor(self, wanted: str = "") -> str:
        """Name of the sensor to follow: the wanted one, or the first.

        Raises:
            LegsimError: the scan has no sensor.
        """
        if not self.signals.sensor_names:
            raise LegsimError(
                "the method follows a sensor, and the scan has none; take uncorrected or autofocus"
            )
        return wanted or self.signals.sensor_names[0]

    def ankle(self, sensor: str) -> FloatArray | None:
        """The ankle (3,) m in a shank's sensor; None where none is known in it."""
        known = (*(leg[2] for leg in self.joints if len(leg) > 2), *self.ankles)
        return next((at.position_sensor for at in known if at.sensor == sensor), None)

    def start(self, sensor: str) -> SensorStart:
        """Finds pose and velocity of one sensor at the first view."""
        if sensor not in self.signals.sensor_names:
            raise LegsimError(
                f"unknown sensor {sensor!r}; known: {', '.join(self.signals.sensor_names)}"
            )
        return self.starts[self.signals.sensor_names.index(sensor)]


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Output of a method for the reconstruction."""

    method: str
    projections: Projections
    """images, warped or as recorded, under the scanner's own geometry

    The motion is separate from it.
    """
    motion: Motion | None
    """motion of the object against its reference pose, which the back-projection follows

    M(i) in P(i) M(i), moving least squares, or displacements. None where voxels stay (uncorrected
    scans and warped images).
    """
    warped_by: ControlPointMotion | None = None
    """points by which images were warped, for the errors of the warp; None for recorded images"""
    notes: tuple[str, ...] = ()
    """sentences for the report"""

    def __repr__(self) -> str:
        motion = "no motion" if self.motion is None else repr(self.motion)
        return f"Correction({self.method}: {len(self.projections.geometry)} views, {motion})"

    def __post_init__(self) -> None:
        if not isinstance(self.projections, Projections):
            raise LegsimError(
                "a Correction's projections are a legsim.geometry.cone_beam.Projections, not "
                f"{type(self.projections).__name__}"
            )
        if not np.isfinite(self.projections.line_integrals).all():
            raise LegsimError(
                "the corrected projections hold values that are not numbers; leave such pixels as "
                "they were recorded"
            )
        if self.motion is None:
            return
        if not isinstance(self.motion, Motion):
            raise LegsimError(
                "a Correction's motion is None, a RigidMotion, a ControlPointMotion or a "
                f"FieldMotion, not {type(self.motion).__name__}"
            )
        views = self.projections.geometry.times
        if len(self.motion.times) != len(views) or np.abs(self.motion.times - views).max() > 1e-6:
            raise LegsimError(
                f"the motion has {len(self.motion.times)} times from {self.motion.times[0]:g} s, "
                f"the projections {len(views)} from {views[0]:g} s; "
                "estimate the motion at the projections' own times"
            )


class CorrectionMethod(Protocol):
    """A whole method.

    The pipeline knows no more of it than this.
    """

    def __call__(self, scan: Scan, /) -> Correction: ...


def checked(name: str, method: CorrectionMethod) -> CorrectionMethod:
    """Wraps a user's own ``method`` so that its errors are one line under its ``name``.

    Raises (when called):
        LegsimError: the method raised anything, or what it returned is no Correction of the scan's
            views and pixels.
    """

    def correct(scan: Scan, /) -> Correction:
        try:
            found = method(scan)
        except LegsimError as error:
            raise LegsimError(f"method {name}: {error}") from error
        except Exception as error:
            inner = traceback.extract_tb(error.__traceback__)[-1]
            what = " ".join(f"{type(error).__name__}: {error}".split())
            raise LegsimError(
                f"method {name} failed in {inner.filename}, line {inner.lineno}: {what}; "
                "fix it and run again (--debug shows the traceback), finished stages are kept"
            ) from error
        if not isinstance(found, Correction):
            raise LegsimError(
                f"method {name} returned {type(found).__name__}; return a "
                "legsim.correction.method.Correction"
            )
        given, got = scan.projections.line_integrals.shape, found.projections.line_integrals.shape
        if got != given:
            raise LegsimError(
                f"method {name} returned {got} (views, rows, columns) for a scan of {given}; "
                "change pixels, but keep their number"
            )
        return found

    return correct
