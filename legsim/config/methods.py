"""Settings of the motion corrections."""

from typing import Literal

from pydantic import Field

from legsim.config.tree import ConfigSection


class FiducialsConfig(ConfigSection):
    """Four metal points in each sensor, which give its start where methods.start is "fiducials"."""

    axis_length_mm: float = Field(default=10.0, gt=0)
    views: int = Field(default=2, ge=2)
    """number of first views used; 2 is as published, more average the errors of detection"""
    detector: Literal["bounded", "unbounded"] = "bounded"
    """"unbounded": the paper's virtual detector

    It also sees what is above and below the real one.
    """
    found: Literal["exact", "images"] = "exact"
    """"exact" projects the points; "images" renders them as beads and finds their shadows"""
    error_px: float = Field(default=0.0, ge=0)
    """standard deviation along u and v added to exact points"""
    bead_mm: float = Field(default=2.0, gt=0)
    """diameter of the rendered beads, tantalum"""


class RoughConfig(ConfigSection):
    """How far starts are off where methods.start is "rough": standard deviations per axis.

    The speed is unknown: starts have none.
    """

    tilt_deg: float = Field(default=1.5, ge=0)
    heading_deg: float = Field(default=3.0, ge=0)
    """about the vertical"""
    velocity_mm_per_s: float = Field(default=30.0, ge=0)
    """speed that methods reckon with"""
    place_mm: float = Field(default=5.0, ge=0)


class BeadsConfig(ConfigSection):
    """Metal beads on the skin around the knee, for the marker-based method.

    They are in no reconstruction.
    """

    count: int = Field(default=12, ge=4)
    diameter_mm: float = Field(default=2.0, gt=0)
    reach_mm: float = Field(default=70.0, gt=0)
    """farthest above and below the knee"""
    guess_error_mm: float = Field(default=2.0, ge=0)
    """standard deviation per axis of the positions from which the search starts"""
    reference: Literal["mean", "bundle"] = "bundle"
    """what each view's pose is fitted to

    "mean": the beads' static mean positions, as published; "bundle": positions estimated together
    with the poses.
    """


class FusedConfig(ConfigSection):
    """What standing, fused-beads, fused and autofocus go by, beside sensor and start."""

    beads: int = Field(default=2, ge=1, le=4)
    """number of beads on the skin of the segment that carries the sensor; in no reconstruction"""
    bead_mm: float = Field(default=2.0, gt=0)
    """their diameter, tantalum"""
    found: Literal["images", "exact"] = "images"
    """"images" renders the beads and tracks their shadows; "exact" projects their true places"""
    error_px: float = Field(default=0.2, ge=0)
    """standard deviation along u and v added to exact places"""
    spread_mm: float = Field(default=2.0, gt=0)
    """RMS of each coordinate by which a knee is expected to move in a scan"""
    clock_ms: float = Field(default=10.0, ge=0)
    """standard deviation of the offset between the clocks of sensors and scanner"""


class MethodsConfig(ConfigSection):
    """Which corrections are compared, and their inputs."""

    run: tuple[str, ...] = (
        *("static", "uncorrected", "marker-based", "rigid", "nonrigid-2d", "nonrigid-3d"),
        *("oracle", "oracle-nonrigid"),
    )
    scheme: Literal["accurate", "paper"] = "accurate"
    """how dead reckoning (rigid, nonrigid, articulated) integrates the IMU signals

    Methods that find a sensor's drift integrate accurately.
    """
    sensor: str = "shank_l"
    """the sensor that the rigid correction follows"""
    start: Literal["truth", "fiducials", "rough"] = "truth"
    """where each sensor's integration starts from at the first view

    "rough" is drawn around the truth, as far off as a sensor that is strapped on by hand.
    """
    legs: Literal["scanned", "both"] = "scanned"
    """legs whose joints the non-rigid methods follow; the other leg needs its own sensors"""
    points_per_segment: int = Field(default=0, ge=0)
    """additional control points of the non-rigid methods, evenly between a segment's joints"""
    node_mm: float = Field(default=8.0, gt=0)
    """spacing of displacement fields: of articulated and oracle-nonrigid, and of more than three
    control points
    """
    fiducials: FiducialsConfig = FiducialsConfig()
    rough: RoughConfig = RoughConfig()
    beads: BeadsConfig = BeadsConfig()
    fused: FusedConfig = FusedConfig()
