"""The settings of a run: one frozen tree, read strictly from TOML.

Lengths are in mm, angles in degrees, with the unit in the name.
"""

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from legsim.core.errors import LegsimError, file_error


class ConfigSection(BaseModel):
    """A part of the configuration: frozen, and strict about its keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class MotionConfig(ConfigSection):
    """The recording and how it is cleaned."""

    file: str = "subject01/squat_60.trc"
    """a path, or the name of one of the shipped recordings under motions/"""
    marker_map: str = "auto"
    """a TOML file, the name of a shipped marker set, or "auto"

    "auto" takes the shipped one that covers the file.
    """
    unit: Literal["file", "m", "cm", "mm"] = "file"
    """"file" takes the header's unit"""
    up: Literal["file", "x", "y", "z", "-x", "-y", "-z"] = "file"
    """"file" takes the file's, or guesses it where the format does not state it"""
    angles: Literal["file", "degrees", "radians"] = "file"
    """unit of joint coordinates; "file" takes the header's unless the angles contradict it"""
    filter_hz: float = Field(default=6.0, ge=0)
    """cut-off of the 2nd-order zero-phase Butterworth filter; 0 leaves the markers as they are"""
    longest_gap_s: float = Field(default=2.0, ge=0)
    """longest gap that is interpolated in time

    In longer ones the marker stays unseen and is reported.
    """
    marker_noise_mm: float = Field(default=0.2, ge=0)
    """RMS of a marker's white noise per axis; 0 leaves the joint angles as the filter does

    Joint angles are filtered further, as low as that noise hides.
    """
    scaling_file: str = ""
    """recording that the model is scaled from

    Empty: the person's active squats for legsim's own recordings, else the same one.
    """
    model: str = ""
    """OpenSim model (.osim) to use, with its own markers and size; empty: legsim's own leg"""
    scale_file: str = ""
    """OpenSim's scale factors (.xml), for legsim's own leg or for the model; empty: none"""
    registration: bool = True
    """find lengths, hip centers and the places of the markers together with the poses

    Else the leg stays as scaled and markers sit where the model has them.
    """


class SensorConfig(ConfigSection):
    """One inertial sensor on a segment."""

    name: str
    segment: str
    distance_mm: float
    """from the segment's proximal joint (its origin) down the segment"""
    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """further offset along the segment's x, y, z"""
    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """rotation vector of the sensor's axes against the segment's"""


class NoiseConfig(ConfigSection):
    """Noise of the sensors, drawn from the run's seed.

    Each kind reads its own numbers; defaults are the BMI160's.
    """

    kind: Literal["none", "density", "rms", "paper"] = "none"
    acceleration_ug_per_sqrt_hz: float = Field(default=180.0, ge=0)
    """density"""
    angular_velocity_deg_per_s_per_sqrt_hz: float = Field(default=0.007, ge=0)
    """density"""
    acceleration_mg: float = Field(default=1.8, ge=0)
    """rms"""
    angular_velocity_deg_per_s: float = Field(default=0.07, ge=0)
    """rms"""
    bandwidth_hz: float = Field(default=100.0, gt=0)
    """bandwidth in which the RMS was measured"""
    f_a: float | Literal["none"] = 0.0
    """paper: the accelerometer's RMS is divided by 10^f_a; "none" is no noise"""
    f_g: float | Literal["none"] = 0.0
    """paper: the same for the gyroscope"""
    convention: Literal["SI", "per-sample"] = "SI"
    """paper: "per-sample" leaves out the time steps, which reproduces the published numbers"""
    acceleration_bias_mg: float = Field(default=0.0, ge=0)
    """standard deviation between sensors; applies to every kind except none"""
    angular_velocity_bias_deg_per_s: float = Field(default=0.0, ge=0)


class SoftTissueConfig(ConfigSection):
    """A damped oscillator between a bone and what is attached to it."""

    amplitude: float = Field(default=0.0, ge=0)
    """share of the oscillator's swing: 0 is fixed to the bone, 1 is the full swing"""
    frequency_hz: float = Field(default=10.0, gt=0)
    damping: float = Field(default=0.25, gt=0)
    """of critical"""


class ImuConfig(ConfigSection):
    """The sensors; defaults are the paper's."""

    rate_hz: float = Field(default=120.0, gt=0)
    clock_offset_s: float = 0.0
    """the sensors' clock minus the C-arm's: what happens at t is stamped t plus this

    No method knows it.
    """
    soft_tissue: SoftTissueConfig = SoftTissueConfig()
    """how the sensors swing on the skin; the truth is that of sensors fixed to the bone"""
    noise: NoiseConfig = NoiseConfig()
    sensors: tuple[SensorConfig, ...] = Field(
        default=(
            SensorConfig(name="shank_l", segment="tibia_l", distance_mm=140),
            SensorConfig(name="thigh_l", segment="femur_l", distance_mm=250),
        ),
        min_length=1,
    )


class PhantomConfig(ConfigSection):
    """The scanned legs."""

    legs: Literal["both", "scanned"] = "both"
    """scanned: the scanned leg alone

    The other leg's edges leave streaks wherever the views are few.
    """
    detail: Literal["coarse", "fine"] = "coarse"
    energy_kev: float = Field(default=60.0, gt=10, le=500)
    tissue_swing: SoftTissueConfig = SoftTissueConfig()
    """how its soft tissue swings on its bones; the sensors have imu.soft_tissue

    Images and truth both show it.
    """


class SpectrumConfig(ConfigSection):
    """The beam's photon energies; "none" is one energy, phantom.energy_kev."""

    kind: Literal["none", "tube", "file"] = "none"
    kvp: float = Field(default=90.0, ge=30, le=300)
    """tube"""
    anode_deg: float = Field(default=12.0, gt=0, lt=90)
    """tube: slope of the anode"""
    aluminum_mm: float = Field(default=3.0, ge=0)
    """tube: filter, including the tube's own"""
    copper_mm: float = Field(default=0.1, ge=0)
    """tube: additional filter"""
    response: Literal["energy", "count"] = "energy"
    """tube: whether the detector weighs a photon by its energy, as flat panels do"""
    file: str = ""
    """file: a CSV of energy_kev,weight, photons as the detector weighs them"""
    water_precorrection: bool = False
    """whether line integrals are linearized as if all were water; bones still harden the beam"""


class DetectorConfig(ConfigSection):
    """What the detector adds to the projections; the defaults add nothing."""

    photons: float = Field(default=0.0, ge=0)
    """per pixel and view of the unattenuated beam; 0: no noise"""
    electronic_noise_photons: float = Field(default=0.0, ge=0)
    """RMS of one reading; needs photons"""
    blur_fwhm_mm: float = Field(default=0.0, ge=0)
    """on the detector"""
    lag_fractions: tuple[float, ...] = ()
    """parts of the signal that traps hold back, one exponential each"""
    lag_times_s: tuple[float, ...] = ()
    """time in which each falls to 1/e"""
    scatter_to_primary: float = Field(default=0.0, ge=0)
    """mean scatter over mean primary within the shadow, the same in every view"""
    scatter_fwhm_mm: float = Field(default=100.0, gt=0)
    """on the detector: how smooth the scatter is"""


class ScanConfig(ConfigSection):
    """The C-arm; defaults are the paper's."""

    side: Literal["left", "right"] = "left"
    """side of the leg in the isocenter; regions, markers, beads and default sensors follow it"""
    center: Literal["knee"] | tuple[float, float, float] = "knee"
    """center of the rotation: the scanned knee at the first view, or a world point in mm"""
    start_s: float | None = None
    """time of the first view in the recording; none: the scan is in the recording's middle"""
    views: int = Field(default=248, ge=2)
    increment_deg: float = 0.8
    rate_hz: float = Field(default=31.0, gt=0)
    first_angle_deg: float = -8.8
    """angle of the source about the vertical; 0 is the subject's right (+z), 90 the front (+x)"""
    source_detector_mm: float = Field(default=1198.0, gt=0)
    source_isocenter_mm: float = Field(default=780.0, gt=0)
    columns: int = Field(default=620, ge=8)
    rows: int = Field(default=480, ge=8)
    pixel_mm: float = Field(default=0.616, gt=0)
    rays_per_pixel: int = Field(default=2, ge=1, le=8)
    """rays along each axis of a pixel

    A pixel is the mean of this number squared; 1 is a single ray through its center.
    """
    spectrum: SpectrumConfig = SpectrumConfig()
    detector: DetectorConfig = DetectorConfig()


class GridConfig(ConfigSection):
    """The reconstructed cube around the isocenter."""

    voxels: int = Field(default=512, ge=16)
    voxel_mm: float = Field(default=0.5, gt=0)


class ReconstructionConfig(ConfigSection):
    """How every volume is reconstructed from its projections."""

    algorithm: Literal["fdk", "cgls"] = "fdk"
    """filtered back-projection, or conjugate gradients for few views, gaps and wide cones"""
    window: Literal["ram-lak", "shepp-logan", "hann"] = "shepp-logan"
    """fdk: the ramp filter, from sharp to smooth; the paper's is shepp-logan"""
    water_attenuation_per_mm: float = Field(default=0.02, ge=0)
    """fdk: width of the cylinder that continues a truncated object; 0 leaves rows truncated"""
    redundancy: Literal["parker", "none"] = "parker"
    """fdk: weights of lines measured more than once; "none" counts every view half"""
    iterations: int = Field(default=15, ge=1)
    """cgls: iterations; fewer are smoother"""
    nonnegative: bool = False
    """cgls: whether attenuation is kept at 0 or above"""


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


class MethodsConfig(ConfigSection):
    """Which corrections are compared, and their inputs."""

    run: tuple[str, ...] = (
        *("static", "uncorrected", "marker-based", "rigid", "nonrigid-2d", "nonrigid-3d"),
        *("oracle", "oracle-nonrigid"),
    )
    scheme: Literal["accurate", "paper"] = "accurate"
    """how poses are integrated from the IMU signals"""
    sensor: str = "shank_l"
    """the sensor that the rigid correction follows"""
    start: Literal["truth", "fiducials"] = "truth"
    """where each sensor's integration starts from at the first view"""
    legs: Literal["scanned", "both"] = "scanned"
    """legs whose joints the non-rigid methods follow; the other leg needs its own sensors"""
    points_per_segment: int = Field(default=0, ge=0)
    """additional control points of the non-rigid methods, evenly between a segment's joints"""
    node_mm: float = Field(default=8.0, gt=0)
    """spacing of displacement fields: of oracle-nonrigid, and of more than three control points"""
    fiducials: FiducialsConfig = FiducialsConfig()
    beads: BeadsConfig = BeadsConfig()


class EvaluationConfig(ConfigSection):
    """How volumes are compared."""

    register_volumes: bool = True
    air_margin_mm: float = Field(default=5.0, ge=0)


class RunConfig(ConfigSection):
    """The settings of one scan."""

    motion: MotionConfig = MotionConfig()
    imu: ImuConfig = ImuConfig()
    phantom: PhantomConfig = PhantomConfig()
    scan: ScanConfig = ScanConfig()
    grid: GridConfig = GridConfig()
    reconstruction: ReconstructionConfig = ReconstructionConfig()
    methods: MethodsConfig = MethodsConfig()
    evaluation: EvaluationConfig = EvaluationConfig()
    seed: int = 0

    @model_validator(mode="before")
    @classmethod
    def _on_the_scanned_side(cls, tree: Any) -> Any:
        """Puts sensors that are not configured on the scanned leg."""
        if not isinstance(tree, dict):
            return tree
        scan, imu, methods = (_section(tree, name) for name in ("scan", "imu", "methods"))
        if scan is None or imu is None or methods is None or scan.get("side") != "right":
            return tree
        right = [
            s.model_dump() | {"name": f"{s.name[:-1]}r", "segment": f"{s.segment[:-1]}r"}
            for s in ImuConfig().sensors
        ]
        return {
            **tree,
            "imu": {"sensors": right, **imu},
            "methods": {"sensor": right[0]["name"], **methods},
        }


def _section(tree: dict[str, Any], name: str) -> dict[str, Any] | None:
    """The given keys of a section in an unvalidated tree; None where it is not a table."""
    found = tree.get(name, {})
    if isinstance(found, ConfigSection):
        return found.model_dump(exclude_unset=True)
    return found if isinstance(found, dict) else None


PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    "paper": {},
    "half": {
        "scan": {"columns": 310, "rows": 240, "pixel_mm": 1.232},
        "grid": {"voxels": 256, "voxel_mm": 1.0},
    },
    "demo": {
        "scan": {"columns": 310, "rows": 240, "pixel_mm": 1.232},
        "grid": {"voxels": 160, "voxel_mm": 1.6},
    },
}


def load_settings(
    path: Path | None = None, *, preset: str = "paper", overrides: tuple[str, ...] = ()
) -> RunConfig:
    """Reads the preset, overlaid by the TOML file, overlaid by ``section.key=value`` overrides.

    Values of overrides are in TOML's notation, or bare text.

    Raises:
        LegsimError: unknown preset, missing file, not TOML, or a key or value that is not allowed;
            the line names the key.
    """
    trees = [] if path is None else [read(path)]
    return from_trees(
        preset, *trees, *(parse_override(override) for override in overrides), where=path
    )


def from_trees(preset: str, *trees: dict[str, Any], where: Path | None = None) -> RunConfig:
    """Overlays the preset by ``trees``, one after the other.

    Errors name ``where`` they come from.

    Raises:
        LegsimError: unknown preset, or a key or value that is not allowed; the line names the key.
    """
    if preset not in PRESETS:
        raise LegsimError(f"--preset {preset}: unknown preset; choose one of {', '.join(PRESETS)}")
    tree: dict[str, Any] = merged({}, PRESETS[preset])
    for further in trees:
        tree = merged(tree, further)
    return validated(RunConfig, tree, where)


_Model = TypeVar("_Model", bound=ConfigSection)


def validated(model: type[_Model], tree: dict[str, Any], where: Path | None) -> _Model:
    """Validates the tree as a configuration of type ``model``.

    Raises:
        LegsimError: a key or value that is not allowed; the line names file and key.
    """
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        raise LegsimError(_explain(error, model, where)) from error


def dump(config: RunConfig) -> str:
    """Returns the whole tree as TOML, which :func:`load_settings` reads back."""
    return tomli_w.dumps(config.model_dump(mode="json", exclude_none=True))


def read(path: Path) -> dict[str, Any]:
    """Reads a TOML file without validation.

    Raises:
        LegsimError: missing file, or not TOML.
    """
    try:
        return tomllib.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        raise file_error(path, "no such file", "give the path of a TOML file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise file_error(
            path, f"cannot be read ({error})", "give the path of a TOML file"
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise file_error(path, f"is not TOML: {error}", "fix that place") from None


def parse_override(text: str) -> dict[str, Any]:
    """Parses ``section.key=value`` as a tree."""
    key, separator, value = text.partition("=")
    parts = key.strip().split(".")
    if not separator or not all(parts):
        raise LegsimError(f"--set {text}: expected section.key=value, as in --set scan.views=124")
    try:
        parsed: Any = tomllib.loads(f"v = {value.strip()}")["v"]
    except tomllib.TOMLDecodeError:
        parsed = value.strip()
    for part in reversed(parts):
        parsed = {part: parsed}
    return parsed


def merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Overlays ``base`` by ``over``, section by section."""
    result = dict(base)
    for key, value in over.items():
        nested = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = merged(result[key], value) if nested else value
    return result


def _explain(error: ValidationError, model: type[ConfigSection], path: Path | None) -> str:
    # a misspelled key comes with a missing one: the misspelling is what to report
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    place = ".".join(str(part) for part in first["loc"])
    where = f"{path or 'configuration'} ({place})"
    if first["type"] == "extra_forbidden":
        return f"{where}: unknown key; {_valid_keys(model, first['loc'])}"
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    override = f" or with --set {place}=..." if model is RunConfig else ""
    return (
        f"{where}: {first['msg']}, not {first['input']!r}{more}; fix the value in the "
        f"file{override}"
    )


def _valid_keys(model: type[ConfigSection], location: tuple[int | str, ...]) -> str:
    section = model
    for part in location[:-1]:
        if isinstance(part, str) and part in section.model_fields:
            section = next(_sections_in(section.model_fields[part].annotation), section)
    return f"valid here: {', '.join(section.model_fields)}"


def _sections_in(annotation: Any) -> Iterator[type[ConfigSection]]:
    """Sections that a field's type names, also inside a tuple or next to None."""
    if isinstance(annotation, type) and issubclass(annotation, ConfigSection):
        yield annotation
    for part in get_args(annotation):
        yield from _sections_in(part)
