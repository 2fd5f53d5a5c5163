"""A measured scan from its SCAN.toml: the input of every method, without any truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from legsim.config import measured_scan
from legsim.config.imu_file import ImuFileConfig, StartConfig
from legsim.config.measured_scan import (
    MeasuredBeadsConfig,
    MeasuredGridConfig,
    MeasuredScanConfig,
)
from legsim.core import transforms
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.correction import initialization
from legsim.correction.fiducials import Fiducials
from legsim.correction.method import Scan
from legsim.correction.standing_start import standing_start
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.scan_files import ScanFiles
from legsim.geometry.volume import VolumeGrid
from legsim.imu import joining, plausibility, strapdown
from legsim.imu.gap_cost import gap_cost, longest_gap
from legsim.imu.joining import JoinedSignals
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.imu.strapdown import Scheme
from legsim.run import imu_files, measured_joints, projection_files, shadow_files
from legsim.run.grids import WantedGrid
from legsim.run.imu_files import WornSensor

_METERS = 5.0
"""mm from the world's origin, within which a place was meant in meters"""

_FAR = 900.0
"""mm between a sensor of a leg and the middle of what is scanned"""

_TILTED_DEG = 30.0
"""by which a hand is not off"""

_AFTER_S = 0.5
"""s after the first view whose mean specific force is about gravity in its pose"""

_LEFT_MG = 60.0
"""offset that no accelerometer has"""

_BRIDGES: dict[Scheme, str] = {
    "accurate": "by a cubic, or less where few samples are beside them",
    "paper": "by straight lines between the samples beside them, as the paper's recursion reads",
}
"""how each scheme bridges a gap"""

_CLOCK_ERROR = 0.01
"""s, an error of a clock's offset whose cost is reported"""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredScan:
    """A scan as a scanner and sensors recorded it."""

    settings: MeasuredScanConfig
    seen: Scan
    """input of methods; its sensors are those with a start"""
    grid: VolumeGrid
    segments: dict[str, str]
    """that carry the sensors, by their names; empty where unknown"""
    left_out: tuple[str, ...]
    """sensors without a start"""
    inputs: tuple[Path, ...]
    """all files that were read"""
    notes: tuple[str, ...]
    """what was found in them, for the report"""
    worn: Mapping[str, StartConfig] = field(default_factory=dict)
    """how each sensor's start was given, by its name"""
    knees_on_thighs: Mapping[str, FloatArray] = field(default_factory=dict)
    """(3,) m, the knee in the sensor of a thigh, by the sensor's name, where it is known"""
    folder: Path = Path()
    """that the settings' files are relative to"""

    def __repr__(self) -> str:
        return f"MeasuredScan({self.seen!r}, {self.grid!r})"


def followed(scan: MeasuredScan) -> str:
    """Sensor that methods of one sensor follow; empty where none has a start."""
    names = scan.seen.signals.sensor_names
    return scan.settings.methods.sensor or (names[0] if names else "")


def load_measured_scan(path: Path | str) -> MeasuredScan:
    """Reads a SCAN.toml and all files that it names.

    Raises:
        LegsimError: a file or value that cannot be used; the line names it and the fix.

    >>> scan = load_measured_scan("SCAN.toml")
    >>> volume = fdk(Rigid("shank_l")(scan.seen), scan.grid)
    """
    path = Path(path)
    return assemble(measured_scan.load(path), path.parent, path)


def assemble(
    settings: MeasuredScanConfig, folder: Path, described_by: Path | None = None
) -> MeasuredScan:
    """Reads all files that ``settings`` name, relative to ``folder``.

    Errors are as those of :func:`load_measured_scan`.
    """
    where = str(described_by or "scan")
    sensors, sensor_files = _sensors(settings, folder)
    read = projection_files.read(settings, folder)
    projections = _timed(read, settings, folder, needs_times=bool(sensors))
    geometry = projections.geometry
    started = [s for s in sensors if s.worn.start is not None]
    joined = _joined(started, geometry)
    found = [_start(s, joined.signals, geometry, settings.methods.scheme) for s in started]
    starts = tuple(start for start, _ in found)
    costs = _costs(started, starts, joined.signals, geometry, settings.methods.scheme)
    _check_carriers(settings.beads, [s.recording.name for s in sensors], where)
    worn = {s.recording.name: s.worn.segment for s in sensors}
    joints = measured_joints.on_sensors(settings.joints, joined.signals.sensor_names, worn, where)
    grid, chosen = _wanted(settings.grid, folder, where).of(geometry)
    rested = settings.methods.sensor_errors.calibration != "none" and all(
        sensor.worn.start is not None and sensor.worn.start.is_given for sensor in started
    )
    signals = _at_rest(joined.signals, starts) if rested else joined.signals
    return MeasuredScan(
        settings,
        Scan(projections, signals, starts, joints.legs, joints.ankles),
        grid,
        worn,
        tuple(s.recording.name for s in sensors if s.worn.start is None),
        (
            *projection_files.files_of(settings, folder),
            *sensor_files,
            *_more_files(settings, folder, started),
            *([described_by] if described_by else []),
        ),
        (
            *(_sentence(note) for note in (*read.notes, *chosen)),
            *(projection_files.time_doubts(geometry.times) if started else ()),
            *joined.notes,
            *(f"In doubt: {line}." for line in plausibility.objections(joined.signals)),
            *(note for _, notes in found for note in notes),
            *costs,
        ),
        {s.recording.name: s.worn.start for s in started if s.worn.start is not None},
        joints.knees,
        folder,
    )


def _more_files(
    settings: MeasuredScanConfig, folder: Path, started: Sequence[WornSensor]
) -> list[Path]:
    """Files beside those of projections and sensors."""
    found = [folder / name for name in (settings.view_times, settings.grid.like) if name]
    found += [
        s.folder / s.worn.start.fiducials
        for s in started
        if s.worn.start is not None and s.worn.start.fiducials
    ]
    found += [folder / given.file for given in settings.beads]
    return found + ([folder / settings.fiducials.file] if settings.fiducials else [])


def _costs(
    started: Sequence[WornSensor],
    starts: Sequence[SensorStart],
    signals: ImuSignals,
    geometry: ConeBeamGeometry,
    scheme: Scheme,
) -> tuple[str, ...]:
    """Sentences on what the sensors' clocks and gaps cost."""
    both = list(zip(started, starts, strict=True))
    return (
        *(_on_clock(sensor, signals, start, geometry, scheme) for sensor, start in both),
        *(
            note
            for sensor, start in both
            for note in _on_gap(sensor, signals, start, geometry.times, scheme)
        ),
    )


def _timed(
    read: ScanFiles, settings: MeasuredScanConfig, folder: Path, *, needs_times: bool
) -> Projections:
    """The projections at the views' own times, as far as anything says them."""
    path = folder / settings.geometry
    times_file = folder / settings.view_times if settings.view_times else None
    timed = projection_files.with_times(
        read.geometry, read.timed, settings.view_rate_hz, times_file
    )
    if timed is None and needs_times:
        raise file_error(
            path,
            "does not say when its views were taken",
            "give view_rate_hz, or view_times, a file of one time in s per view",
        )
    return read.projections if timed is None else replace(read.projections, geometry=timed)


def _sentence(note: str) -> str:
    return f"{note[:1].upper()}{note[1:].rstrip('.')}."


def _sensors(settings: MeasuredScanConfig, folder: Path) -> tuple[list[WornSensor], list[Path]]:
    """All sensors, and the files that were read for them."""
    found: list[WornSensor] = []
    read: list[Path] = []
    for entry in settings.imu:
        if isinstance(entry, ImuFileConfig):
            found += imu_files.load_configured(entry, folder)
            read.append(folder / entry.file)
        else:
            worn = imu_files.load(folder / entry)
            found += worn
            read += [folder / entry, *(one.file for one in worn)]
    return found, list(dict.fromkeys(read))


def _joined(sensors: Sequence[WornSensor], geometry: ConeBeamGeometry) -> JoinedSignals:
    """The signals of all sensors by the views' clock; none where no sensor has a start."""
    if not sensors:
        none = np.zeros((len(geometry), 0, 3))
        return JoinedSignals(ImuSignals(geometry.times, (), none, none), ())
    joined = joining.join([s.recording for s in sensors])
    views, times = geometry.times, joined.signals.times
    if views[0] < times[0] - 1e-9 or views[-1] > times[-1] + 1e-9:
        names = ", ".join(joined.signals.sensor_names)
        guess = projection_files.unit_guess(float(views[-1] - views[0]))
        other = f", or correct the times of the views: {guess}" if guess else ""
        late, early = float(times[0] - views[0]), float(views[-1] - times[-1])
        short = [f"begin {late:.13g} s after them"] * (late > 0)
        short += [f"end {early:.13g} s before them"] * (early > 0)
        raise LegsimError(
            f"the views are from {views[0]:.13g} to {views[-1]:.13g} s, sensors {names} recorded "
            f"{times[0]:.13g} to {times[-1]:.13g} s by the views' clock, and "
            f"{' and '.join(short)}; give clock_offset_s (sensors' clock minus "
            f"the views'){other}"
        )
    return joined


def _at_rest(signals: ImuSignals, starts: Sequence[SensorStart]) -> ImuSignals:
    """The signals after a rest, upon which the starts were leveled: upwards, as these have it."""
    up = [start.world_from_sensor[1, :3] for start in starts]
    return replace(signals, rest_force=STANDARD_GRAVITY * np.array(up).reshape(-1, 3))


def _on_clock(
    sensor: WornSensor,
    signals: ImuSignals,
    start: SensorStart,
    geometry: ConeBeamGeometry,
    scheme: Scheme,
) -> str:
    """What is assumed of a sensor's clock, and what an error of it costs."""
    name, views = sensor.recording.name, geometry.times
    before, after = views[0] - signals.times[0], signals.times[-1] - views[-1]
    stated = "clock_offset_s" if sensor.clock_stated else "assumed: clock_offset_s is not given"
    said = (
        f"Sensor {name}: its clock is taken to read {sensor.clock_offset + 0.0:g} s more than the "
        f"views' ({stated}); it recorded {before:.2g} s before and {after:.2g} s after them."
    )
    if max(before, after) < _CLOCK_ERROR:
        return said
    late = replace(signals, times=signals.times + _CLOCK_ERROR * (1 if before > after else -1))
    other = _start(sensor, late, geometry, scheme)[0]
    center = geometry.rotation_center()[None]
    places = []
    for heard, begun in ((signals, start), (late, other)):
        path = strapdown.integrate(*heard.samples(name), begun, views, scheme=scheme)
        places.append(transforms.apply(path @ transforms.inverse(path[0]), center)[:, 0])
    moved = float(np.linalg.norm(places[1] - places[0], axis=-1).max())
    return (
        f"{said} An offset that is wrong by {1e3 * _CLOCK_ERROR:g} ms moves the rotation center, "
        f"where it is followed, by up to {1e3 * moved:.3g} mm."
    )


def _on_gap(
    sensor: WornSensor, signals: ImuSignals, start: SensorStart, views: FloatArray, scheme: Scheme
) -> tuple[str, ...]:
    """What the longest gap of a sensor costs; nothing without one."""
    name = sensor.recording.name
    seconds = longest_gap(signals.samples(name)[0], views)
    if not 0 < seconds < views[-1] - views[0]:
        return ()
    cost = gap_cost(signals.samples(name), start, views, seconds, scheme)
    return (
        f"Sensor {name}: gaps of up to {1e3 * seconds:.0f} ms are bridged {_BRIDGES[scheme]}. The "
        f"same gap elsewhere in the scan displaces the sensor by {1e3 * cost:.3g} mm RMS at the "
        "last view, where nothing else finds its drift.",
    )


def _start(
    sensor: WornSensor, signals: ImuSignals, geometry: ConeBeamGeometry, scheme: Scheme
) -> tuple[SensorStart, tuple[str, ...]]:
    """Pose and velocity of a sensor at the first view, and sentences on how they are known."""
    name, given = sensor.recording.name, sensor.worn.start
    assert given is not None  # only sensors with one are asked for
    try:
        if given.fiducials:
            path = sensor.folder / given.fiducials
            pixels = shadow_files.load_fiducials(
                path, geometry, bounded=given.detector == "bounded"
            )
            pixels = shadow_files.first_views(path, pixels)
            fiducials = Fiducials(1e-3 * given.axis_length_mm)
            found = initialization.start_from_fiducials(
                signals,
                name,
                geometry,
                pixels,
                fiducials,
                scheme=scheme,
                detector=given.detector,
            )
            doubts = _doubtful_gravity(name, found.start, signals, geometry.times)
            return found.start, (initialization.conditioning(name, found), *doubts)
        pose = stated_pose(given)
        doubts = _doubtful_place(name, given, geometry)
        if given.is_given:
            start = SensorStart(pose, 1e-3 * np.array(given.velocity_mm_s))
            return start, (*doubts, *_doubtful_gravity(name, start, signals, geometry.times))
        stands = standing_start(signals, name, pose, geometry.times, scheme=scheme)
    except LegsimError as error:
        raise LegsimError(f"start of sensor {name}: {error}") from error
    said = _on_standing(name, given, stands.tilted, stands.vertical_acceleration)
    return stands.start, (*said, *doubts)


def _doubtful_place(name: str, given: StartConfig, geometry: ConeBeamGeometry) -> tuple[str, ...]:
    """Doubts a stated place in meters, or far from what is scanned."""
    place = np.array(given.position_mm)
    if 0 < np.linalg.norm(place) < _METERS:
        return (
            f"In doubt: sensor {name} starts at {place.tolist()} mm, within a fingernail of the "
            "world's origin: position_mm is in mm, these look like meters.",
        )
    far = 1e3 * float(np.linalg.norm(1e-3 * place - geometry.rotation_center()))
    if far < _FAR:
        return ()
    center = np.round(1e3 * geometry.rotation_center()).astype(int).tolist()
    return (
        f"In doubt: sensor {name} starts {far:.0f} mm from the rotation center, which is at "
        f"{center} mm, farther than any of a scanned leg: check position_mm.",
    )


def _tilted(name: str, tilted: float) -> tuple[str, ...]:
    """A doubt of a pose by which gravity is ``tilted`` rad off; nothing where a hand may be."""
    if np.degrees(tilted) <= _TILTED_DEG:
        return ()
    return (
        f"In doubt: gravity in sensor {name} is {np.degrees(tilted):.0f} deg from where its pose "
        "has it: check the rotation (of world from sensor, in degrees), the order and signs of the "
        "acceleration's columns, and that at rest it points upwards.",
    )


def _doubtful_gravity(
    name: str, start: SensorStart, signals: ImuSignals, views: FloatArray
) -> tuple[str, ...]:
    """Doubts a pose at the first view by the specific force just after it."""
    times, _, force = signals.samples(name)
    after = (times >= views[0]) & (times <= views[0] + _AFTER_S)
    if not after.any():
        return ()
    felt = start.world_from_sensor[:3, :3] @ force[after].mean(0)
    upwards = felt[1] / max(float(np.linalg.norm(felt)), 1e-9)
    return _tilted(name, float(np.arccos(np.clip(upwards, -1, 1))))


def _on_standing(name: str, given: StartConfig, tilted: float, vertical: float) -> tuple[str, ...]:
    heading = np.radians(given.heading_sd_deg)
    doubts = [*_tilted(name, tilted)]
    if abs(vertical) > _LEFT_MG * 9.80665e-3:
        doubts.append(
            f"In doubt: {vertical / 9.80665e-3:.0f} mg along the vertical are more than the error "
            f"of any accelerometer: check unit and columns of the acceleration of {name}."
        )
    return (
        *doubts,
        f"Sensor {name} starts such that its person stays in place over the scan: turned by "
        f"{np.degrees(tilted):.2f} deg against the given pose; {vertical / 9.80665e-3:.1f} mg are "
        "left along the vertical, an error of the accelerometer.",
        f"Sensor {name}: its turn about the vertical is known to {given.heading_sd_deg:g} deg, "
        f"which turns all horizontal motion by as much ({100 * heading:.1f} % of it), its place to "
        f"{given.position_sd_mm:g} mm, which moves what is turned by 1 deg by "
        f"{given.position_sd_mm * np.radians(1):.2g} mm.",
    )


def stated_pose(given: StartConfig) -> np.ndarray:
    """World_from_sensor (4, 4) of a stated pose."""
    if given.rotation is not None:
        rotation = np.array(given.rotation)
    else:
        rotation = transforms.rotation_from_vector(np.radians(given.rotation_deg or (0, 0, 0)))
    return transforms.rigid(rotation, 1e-3 * np.array(given.position_mm))


def _check_carriers(
    beads: Sequence[MeasuredBeadsConfig], sensors: Sequence[str], where: str
) -> None:
    """Refuses beads on the segment of a sensor that is not there."""
    for one in beads:
        if one.sensor and one.sensor not in sensors:
            have = ", ".join(sensors) or "none"
            raise LegsimError(
                f"{where} (beads): {one.file} is on the segment of {one.sensor!r}, which is no "
                f"sensor of this scan; there: {have}"
            )


def _wanted(given: MeasuredGridConfig, folder: Path, where: str) -> WantedGrid:
    like = folder / given.like if given.like else None
    return WantedGrid(
        like, given.shape_zyx, given.spacing_mm, given.center_mm, where=f"{where} (grid)"
    )
