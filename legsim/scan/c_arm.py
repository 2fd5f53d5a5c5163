"""The C-arm: when views are taken, where source and detector are, how the beam is read."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import VolumeGrid
from legsim.scan.acquisition import Imaging


@dataclass(frozen=True, slots=True, eq=False)
class CArm:
    """A scan on a circle about the vertical through the isocenter.

    >>> CArm.half()
    CArm(248 views of 310x240 pixels of 1.232 mm over 197.6 deg in 7.97 s)
    """

    angles: FloatArray
    """(v,) rad of the source about the vertical

    0 is the subject's right (+z), 90 degrees the front (+x).
    """
    rate_hz: float
    """views per second"""
    source_isocenter: float
    """m"""
    source_detector: float
    """m"""
    shape_vu: tuple[int, int]
    """rows and columns"""
    pixel_pitch: float
    """m on the detector"""
    start: float | None = None
    """s, time of the first view in the recording; None puts the scan in its middle"""
    rays_per_pixel: int = 2
    """along each axis: a pixel is the mean of this number of rays squared"""
    imaging: Imaging = field(default_factory=Imaging)

    def __post_init__(self) -> None:
        object.__setattr__(self, "angles", frozen("CArm.angles", self.angles, (None,)))
        if len(self.angles) < 2 or not np.isfinite(self.angles).all():
            raise LegsimError("CArm.angles: a scan needs at least two angles, all finite numbers")
        for name in ("rate_hz", "source_isocenter", "source_detector", "pixel_pitch"):
            if not getattr(self, name) > 0:
                raise LegsimError(f"CArm.{name} is {getattr(self, name)}; give a positive number")
        if self.source_detector <= self.source_isocenter:
            raise LegsimError(
                f"the detector, {self.source_detector:g} m from the source, is in front of the "
                f"isocenter at {self.source_isocenter:g} m; exchange the two distances"
            )

    def __repr__(self) -> str:
        rows, columns = self.shape_vu
        arc = np.degrees(np.ptp(self.angles))
        return (
            f"CArm({len(self.angles)} views of {columns}x{rows} pixels of "
            f"{1e3 * self.pixel_pitch:g} mm over {arc:.4g} deg in {self.duration:.3g} s)"
        )

    @classmethod
    def paper(cls, **changes: object) -> "CArm":
        """The published scan (Maier et al. 2022, section 2.1): 248 views of 620 x 480 pixels."""
        angles = np.radians(-8.8 + 0.8 * np.arange(248))
        made = cls(angles, 31.0, 1e-3 * 780.0, 1e-3 * 1198.0, (480, 620), 1e-3 * 0.616)
        return replace(made, **changes) if changes else made

    @classmethod
    def half(cls, **changes: object) -> "CArm":
        """The published scan with pixels of twice the size."""
        coarse: dict[str, object] = {"shape_vu": (240, 310), "pixel_pitch": 1e-3 * 1.232}
        return cls.paper(**(coarse | changes))

    @property
    def duration(self) -> float:
        """s from the first view to the last."""
        return (len(self.angles) - 1) / self.rate_hz

    @property
    def field_of_view(self) -> float:
        """Radius (m) of the cylinder about the axis that every view sees completely."""
        half_fan = np.arctan(0.5 * self.shape_vu[1] * self.pixel_pitch / self.source_detector)
        return float(self.source_isocenter * np.sin(half_fan))

    def view_times(self, recorded: FloatArray) -> FloatArray:
        """Times (v,) s of the views within a recording with samples at ``recorded`` (n,) s.

        Raises:
            LegsimError: the recording is shorter than the scan, or the scan passes one of its ends.
        """
        first, last = float(recorded[0]), float(recorded[-1])
        if self.duration > last - first:
            raise LegsimError(
                f"the recording lasts {last - first:.2f} s, the scan {self.duration:.2f} s "
                f"({len(self.angles)} views at {self.rate_hz:g} Hz); use a longer recording, or "
                "fewer views (scan.views) or a higher rate (scan.rate_hz)"
            )
        centered = first + 0.5 * (last - first - self.duration)
        start = centered if self.start is None else self.start
        if start < first or start + self.duration > last:
            raise LegsimError(
                f"the scan would run from {start:.2f} to {start + self.duration:.2f} s, the "
                f"recording from {first:.2f} to {last:.2f} s; "
                f"set scan.start_s between {_inside(first, last - self.duration)}"
            )
        return start + np.arange(len(self.angles)) / self.rate_hz

    def geometry(self, times: ArrayLike, isocenter: ArrayLike) -> ConeBeamGeometry:
        """The views at ``times`` (v,) s about the vertical through ``isocenter`` (3,) m."""
        return ConeBeamGeometry.circular(
            times=times,
            angles=self.angles,
            source_isocenter=self.source_isocenter,
            source_detector=self.source_detector,
            shape_vu=self.shape_vu,
            pixel_pitch=self.pixel_pitch,
            isocenter=isocenter,
        )

    def seen_by_every_view(self, grid: VolumeGrid, *, margin: float = 0.0) -> NDArray[np.bool_]:
        """Voxels (z, y, x) of a grid about the isocenter that every source of a whole turn sees.

        They lie in the cylinder of :attr:`field_of_view`, and between the cones from the sources
        to the detector's upper and lower edge, there by more than ``margin`` (m) for what moves up
        and down.
        """
        x, y, z = (axis - middle for axis, middle in zip(grid.axes(), grid.center, strict=True))
        away = np.hypot(x[None, :], z[:, None])
        # the nearest source has the voxel at a depth of source_isocenter - away
        slope = 0.5 * self.shape_vu[0] * self.pixel_pitch / self.source_detector
        reach = np.where(away <= self.field_of_view, slope * (self.source_isocenter - away), -1.0)
        return np.abs(y)[None, :, None] <= reach[:, None, :] - margin


def _inside(low: float, high: float) -> str:
    """Two numbers of few digits that lie between two others: "0.01 and 4.03"."""
    for digits in range(2, 9):
        scale = 10**digits
        first, last = np.ceil(low * scale) / scale, np.floor(high * scale) / scale
        if first <= last:
            return f"{first:.{digits}f} and {last:.{digits}f}"
    return f"{low!r} and {high!r}"
