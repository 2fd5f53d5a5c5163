"""Settings of a measured scan, SCAN.toml: what a scanner and sensors recorded.

Files are named relative to the SCAN.toml.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import BeforeValidator, Field

from legsim.config.imu import AccelerometerConfig, GyroscopeConfig
from legsim.config.imu_file import ImuFileConfig, Vector
from legsim.config.reconstruction import ReconstructionConfig
from legsim.config.tree import ConfigSection, validated
from legsim.core.files import load_toml


class JointConfig(ConfigSection):
    """A joint, or a further point of a leg, on the sensor that carries it."""

    name: str
    """hip_l, knee_l, ankle_l, or any other name that ends in the leg's _l or _r

    The knee may be there twice, on the shank's sensor and on the thigh's.
    """
    sensor: str
    position_mm: Vector
    """in the sensor's own axes, from its origin"""


class MeasuredGridConfig(ConfigSection):
    """The volume to reconstruct: that of another volume, or numbers; else the field of view."""

    like: str = ""
    """a volume whose grid to take"""
    shape_zyx: tuple[int, int, int] | None = None
    spacing_mm: Vector | None = None
    """along x, y, z"""
    center_mm: Vector | None = None
    """None: the scan's rotation center"""


class CountsConfig(ConfigSection):
    """How a detector's counts become line integrals; nothing is given where they are."""

    i0: float | None = Field(default=None, gt=0)
    """reading without an object, the same everywhere"""
    air: str = ""
    """X0:X1,Y0:Y1, columns and rows that see no object in any view"""
    flat: str = ""
    """images without an object"""
    dark: str = ""
    """images without a beam"""
    bad_pixels: str = ""
    """an image that is not 0 where a pixel is bad"""


class MeasuredBeadsConfig(ConfigSection):
    """Metal beads on the skin: of a sensor's segment, or around the knee for marker-based."""

    file: str
    """CSV of view,bead,u,v: pixels of their shadows, in as many views as show them"""
    sensor: str = ""
    """whose segment carries them; empty: the followed sensor's"""
    track: bool = False
    """the file holds each bead in a few views, by hand; all others are found in the projections"""
    diameter_mm: float = Field(default=2.0, gt=0)
    """of a bead, where they are tracked"""
    error_px: float = Field(default=0.3, gt=0)
    """standard deviation of a shadow along u and v, of its detection and of skin that slides"""


class MeasuredFiducialsConfig(ConfigSection):
    """Four metal points in the followed sensor: its origin and one on each of its axes."""

    file: str
    """CSV of view,point,u,v: pixels of origin, x, y and z, in as many views as show them"""
    axis_length_mm: float = Field(default=10.0, gt=0)
    """from the origin to each of the others"""
    error_px: float = Field(default=0.3, gt=0)
    """standard deviation along u and v"""


class ExpectedErrorsConfig(ConfigSection):
    """What differs from sensor_model: single numbers, as in imu.noise of a run, and calibration."""

    accelerometer: AccelerometerConfig = AccelerometerConfig()
    gyroscope: GyroscopeConfig = GyroscopeConfig()
    off: tuple[str, ...] = ()
    """names of error terms that it does not have, such as "temperature\""""
    calibration: Literal["none", "rest", "six-positions"] = "none"
    """what was recorded before the scan, and the signals and starts corrected by"""
    rest_s: float = Field(default=10.0, gt=0)
    """duration of each rest of the calibration"""
    warms: bool = False
    """whether its temperature changes after the calibration"""


class MeasuredMethodsConfig(ConfigSection):
    """Options of the methods, as in a run."""

    sensor: str = ""
    """that rigid methods follow; empty: the first one with a start"""
    scheme: Literal["accurate", "paper"] = "accurate"
    node_mm: float = Field(default=8.0, gt=0)
    sensor_model: str = "bmi160"
    """whose errors standing and fused-beads expect: of the catalogue, or a TOML file of a sensor;
    custom: none but those of sensor_errors
    """
    sensor_errors: ExpectedErrorsConfig = ExpectedErrorsConfig()
    spread_mm: float = Field(default=2.0, gt=0)
    """RMS of each coordinate by which a knee is expected to move in a scan"""
    clock_ms: float = Field(default=10.0, ge=0)
    """standard deviation of the offset between the clocks that is left"""


def _in_a_list(given: Any) -> Any:
    """One table [beads] is a list of one, and None is none."""
    return (given,) if isinstance(given, (dict, MeasuredBeadsConfig)) else given or ()


class MeasuredScanConfig(ConfigSection):
    """A scan with all that is known of it."""

    projections: str
    """one image per view: a file, a folder, or a pattern with a *"""
    geometry: str
    format: str = ""
    """of the geometry, where its content does not tell"""
    up: Literal["x", "y", "z"] = "y"
    """the geometry's axis that becomes the vertical"""
    columns: int | None = Field(default=None, gt=0)
    """of the detector; the images say it too"""
    rows: int | None = Field(default=None, gt=0)
    pixel_mm: float | tuple[float, float] | None = None
    """or (between columns, between rows)"""
    origin_mm: tuple[float, float] | None = None
    """of the first pixel's center on the detector, for RTK's geometries"""
    raw: str = ""
    """layout of images without a header, such as U16:620x480x248:512"""
    turn_rows: bool = False
    """whether the images' rows are taken from the last to the first"""
    line_integrals: bool = False
    """that the images hold them, whatever their values look like"""
    counts: CountsConfig = CountsConfig()
    view_rate_hz: float | None = Field(default=None, ge=1e-3, le=1e9)
    """views per second, where the geometry holds no times; the first view is at 0 s"""
    view_times: str = ""
    """text file of one time in s per view, in place of the geometry's"""
    imu: tuple[ImuFileConfig | str, ...] = ()
    """files of sensors, or the names of TOML files about them"""
    joints: tuple[JointConfig, ...] = ()
    beads: Annotated[tuple[MeasuredBeadsConfig, ...], BeforeValidator(_in_a_list)] = ()
    fiducials: MeasuredFiducialsConfig | None = None
    grid: MeasuredGridConfig = MeasuredGridConfig()
    reconstruction: ReconstructionConfig = ReconstructionConfig()
    methods: MeasuredMethodsConfig = MeasuredMethodsConfig()


def load(path: Path) -> MeasuredScanConfig:
    """Reads a SCAN.toml.

    Raises:
        LegsimError: missing file, not TOML, or a key or value that is not allowed.
    """
    return validated(MeasuredScanConfig, load_toml(path), path)


def dump(scan: MeasuredScanConfig) -> str:
    """Returns the whole tree as TOML, which :func:`load` reads back."""
    return tomli_w.dumps(scan.model_dump(mode="json", exclude_none=True, exclude_defaults=True))
