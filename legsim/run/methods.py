"""Correction methods by name: the package's, installed ones, and a user's own file.

Installed ones are entry points.
"""

import importlib.metadata
import importlib.util
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from legsim.core.errors import LegsimError, file_error
from legsim.core.files import is_file
from legsim.correction import method as correction_method
from legsim.correction.articulated import Articulated
from legsim.correction.articulated_beads import ArticulatedBeads, BeadedLeg
from legsim.correction.autofocus import Autofocus
from legsim.correction.bead_scan import BeadScan
from legsim.correction.bead_tracking import Reference
from legsim.correction.bones_2d3d import Bones2D3D
from legsim.correction.expected_drift import drift_warning
from legsim.correction.fused import FusedBeads, FusedFiducials, SensorPriors, Standing
from legsim.correction.fused_images import FusedImages
from legsim.correction.marker_based import MarkerBased
from legsim.correction.method import Correction, CorrectionMethod, Scan
from legsim.correction.nonrigid import NonRigid2D, NonRigid3D
from legsim.correction.oracle import Oracle
from legsim.correction.path_measurements import BeadShadows, FiducialShadows
from legsim.correction.rigid import Rigid, Uncorrected
from legsim.correction.rough_start import StartErrors
from legsim.geometry.volume import VolumeGrid
from legsim.imu.strapdown import Scheme
from legsim.opencl.device import Device
from legsim.run import own_code
from legsim.simulation.simulated_scan import ScanTruth

ENTRY_POINTS = "legsim.methods"

REFERENCE = "static"
"""the motion-free scan: no correction, but the reference of all comparisons"""

_RIGID_FROM = "rigid@"


@dataclass(frozen=True, slots=True, eq=False)
class MethodInputs:
    """Inputs of the package's own methods; only oracles use the truth."""

    sensor: str
    """the sensor that rigid methods follow"""
    scheme: Scheme
    device: Device
    nodes: VolumeGrid
    """coarse grid over the volume for displacement fields"""
    scanned_shank: str
    """segment whose true motion the rigid oracle takes"""
    truth: ScanTruth | None
    """None for a measured scan"""
    beads: Callable[[], BeadScan | BeadShadows] | None
    """beads around the knee, simulated or found when called; None where there are none"""
    priors: SensorPriors = field(default_factory=SensorPriors)
    """what is known beforehand of the sensor that is followed"""
    fused_beads: Callable[[], BeadScan | BeadShadows] | None = None
    """few beads on the sensor's segment, made when called; None where there are none"""
    fused_fiducials: Callable[[], FiducialShadows] | None = None
    """points in the followed sensor, seen in all views; None for a measured scan"""
    beaded_leg: BeadedLeg | None = None
    """few beads on both segments of the scanned leg; None where one has none"""
    bead_reference: Reference = "bundle"
    """what the beads' poses are fitted to"""


FOLLOW_ONE, FOLLOW_JOINTS = (
    ("rigid", "rigid-paper-order", "standing", "fused", "fused-beads", "fused-fiducials"),
    ("nonrigid-2d", "nonrigid-3d", "articulated", "articulated-beads"),
)
"""methods that need the sensor of methods.sensor, and those that need thigh and shank"""


FIND_START = (
    *("standing", "fused", "fused-beads", "fused-fiducials", "articulated-beads"),
    "bones-2d3d",
)
"""methods that find start and drift themselves, from a start as it was strapped on"""

DEAD_RECKONING = ("rigid", "rigid-paper-order", "nonrigid-2d", "nonrigid-3d", "articulated")
"""methods that follow sensors alone, wherever these drift"""


def undetermined(
    names: Sequence[str],
    scan: Scan,
    sensor: str,
    priors: SensorPriors,
    starts: Mapping[str, StartErrors] | None = None,
) -> list[str]:
    """A sentence for each method and sensor whose expected drift hides how a person moves.

    Args:
        names: of the methods.
        scan: as methods see it.
        sensor: the one that rigid methods follow.
        priors: what is known of every sensor.
        starts: how far the starts of some sensors may be off, by name; else as ``priors`` say.
    """
    on_joints = dict.fromkeys(point.sensor for leg in scan.joints for point in leg)
    said = []
    for name in names:
        own = rigid_sensor(name)
        if own is None and name not in DEAD_RECKONING:
            continue
        followed = on_joints if name in FOLLOW_JOINTS else (own or sensor,)
        for one in followed:
            known = replace(priors, start=(starts or {}).get(one, priors.start))
            said.append(drift_warning(name, scan, one, known))
    return [line for line in said if line]


def _oracle(given: MethodInputs) -> CorrectionMethod:
    return Oracle(_truth(given, "oracle").motion_of(given.scanned_shank))


def _nonrigid_oracle(given: MethodInputs) -> CorrectionMethod:
    truth = _truth(given, "oracle-nonrigid")
    return Oracle(partial(truth.field, given.nodes), "oracle-nonrigid")


def _truth(given: MethodInputs, name: str) -> ScanTruth:
    if given.truth is None:
        raise LegsimError(
            f"{name} follows the true motion, which only a simulated scan has; leave it out"
        )
    return given.truth


def _marker_based(given: MethodInputs) -> CorrectionMethod:
    if given.beads is None:
        raise LegsimError(
            "marker-based follows beads on the skin: give the pixels of their shadows as [[beads]] "
            "in SCAN.toml"
        )
    return MarkerBased(given.beads, given.bead_reference)


def _fused_beads(given: MethodInputs) -> CorrectionMethod:
    if given.fused_beads is None:
        raise LegsimError(
            f"fused-beads follows beads on the segment of sensor {given.sensor}: give the pixels "
            f'of their shadows as [[beads]] with sensor = "{given.sensor}" in SCAN.toml'
        )
    return FusedBeads(given.fused_beads, given.sensor, given.priors)


def _fused_fiducials(given: MethodInputs) -> CorrectionMethod:
    if given.fused_fiducials is None:
        raise LegsimError(
            "fused-fiducials follows points in the sensor: give the pixels of their shadows as "
            "[fiducials] in SCAN.toml"
        )
    return FusedFiducials(given.fused_fiducials, given.sensor, given.priors)


def _articulated_beads(given: MethodInputs) -> CorrectionMethod:
    if given.beaded_leg is None:
        raise LegsimError(
            "articulated-beads follows sensors on thigh and shank of the scanned leg: configure "
            "both (imu.sensors)"
        )
    return ArticulatedBeads(given.beaded_leg, given.priors, given.nodes, given.device)


BUILT_IN: dict[str, Callable[[MethodInputs], CorrectionMethod]] = {
    "uncorrected": lambda _: Uncorrected(),
    "oracle": _oracle,
    "oracle-nonrigid": _nonrigid_oracle,
    "marker-based": _marker_based,
    "rigid": lambda given: Rigid(given.sensor, given.scheme),
    "nonrigid-2d": lambda given: NonRigid2D(scheme=given.scheme, device=given.device),
    "nonrigid-3d": lambda given: NonRigid3D(given.nodes, given.scheme),
    "articulated": lambda given: Articulated(given.nodes, given.scheme, given.device),
    "articulated-beads": _articulated_beads,
    "bones-2d3d": lambda given: Bones2D3D(given.nodes, given.priors, device=given.device),
    "standing": lambda given: Standing(given.sensor, given.priors),
    "fused-beads": _fused_beads,
    "fused-fiducials": _fused_fiducials,
    "fused": lambda given: FusedImages(given.sensor, given.priors, given.device),
    "autofocus": lambda given: Autofocus(given.priors.spread, device=given.device),
    "rigid-paper-order": lambda given: Rigid(given.sensor, given.scheme, "paper"),
}


def find(name: str) -> Callable[[MethodInputs], CorrectionMethod]:
    """Finds what builds the method of that name.

    The name is built in, an entry point of the group ``legsim.methods``, or
    ``path/to/file.py:function``. ``rigid@<sensor>`` is the rigid correction from that sensor,
    whatever the settings name. An entry point and a file's function are the method itself: called
    with a :class:`legsim.correction.method.Scan`.

    Raises:
        LegsimError: unknown method; the line lists the known ones.
    """
    if name in BUILT_IN:
        return BUILT_IN[name]
    sensor = rigid_sensor(name)
    if sensor is not None:
        return lambda given: Rigid(sensor, given.scheme)
    path, separator, function = name.rpartition(":")
    if separator and path.endswith(".py"):
        own = correction_method.checked(label(name), _from_file(Path(path), function))
        return lambda _: own
    installed = {point.name: point for point in importlib.metadata.entry_points(group=ENTRY_POINTS)}
    if name in installed:
        own = correction_method.checked(name, _installed(installed[name]))
        return lambda _: own
    known = ", ".join([REFERENCE, *BUILT_IN, f"{_RIGID_FROM}<sensor>", *installed])
    raise LegsimError(
        f"unknown correction method {name!r}; known: {known}, or your own as "
        "path/to/file.py:function"
    )


def build(name: str, given: MethodInputs) -> CorrectionMethod:
    """Builds the method of that name; errors as in :func:`find`."""
    return find(name)(given)


def check_names(names: Sequence[str], place: str) -> None:
    """Refuses unknown methods, and two of one label; ``place`` is where they are named.

    Raises:
        LegsimError: such a name; as :func:`find`.
    """
    labels = [label(name) for name in names]
    for name, own in zip(names, labels, strict=True):
        find(name)
        # what is said of legsim's own methods, and published of them, would be said of it
        taken = own == REFERENCE or (own in BUILT_IN and name != own)
        if labels.count(own) > 1 or taken:
            raise LegsimError(
                f"{place}: {name} would be called {own!r} like another method; rename its function"
            )


def rigid_sensor(name: str) -> str | None:
    """Finds the sensor of a name such as ``rigid@thigh_l``; None for other names."""
    return name.removeprefix(_RIGID_FROM) if name.startswith(_RIGID_FROM) else None


def label(name: str) -> str:
    """Label of a method in tables and file names.

    It is the method's name, or the function's where it comes from a file. What no file name can
    hold, in the name of a sensor, becomes an underscore.
    """
    shown = name if rigid_sensor(name) is not None else name.rpartition(":")[2]
    return re.sub(r'[/\\:*?"<>|]', "_", shown)


def fingerprint(name: str) -> str:
    """Part of the key that changes with the code of a user's own method and of what it imports.

    A run then computes the method again.
    """
    path, separator, _ = name.rpartition(":")
    if separator and is_file(path):
        return own_code.fingerprint(Path(path))
    module = next(
        (
            p.module
            for p in importlib.metadata.entry_points(group=ENTRY_POINTS)
            if p.name == name and name not in BUILT_IN
        ),
        None,
    )
    spec = None if module is None else importlib.util.find_spec(module)
    if spec is None or spec.origin is None:
        return name
    return own_code.fingerprint(Path(spec.origin))


def _installed(point: importlib.metadata.EntryPoint) -> CorrectionMethod:
    try:
        method = point.load()
    except Exception as error:
        problem = (
            f"method {point.name}: {point.value} cannot be loaded ({type(error).__name__}: {error})"
        )
        raise LegsimError(f"{problem}; fix or remove the package that offers it") from error
    if not callable(method):
        raise LegsimError(
            f"method {point.name}: {point.value} is not a function; name one in "
            f'[project.entry-points."{ENTRY_POINTS}"]'
        )
    return cast(CorrectionMethod, method)


def _from_file(path: Path, function: str) -> CorrectionMethod:
    if not is_file(path):
        raise file_error(path, "no such file", "give a method as path/to/file.py:function")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise file_error(path, "is not a Python file", "give a method as path/to/file.py:function")
    module = importlib.util.module_from_spec(spec)
    try:
        with own_code.importable(path, anew=True):
            spec.loader.exec_module(module)
    except LegsimError:
        raise
    except Exception as error:
        raise file_error(
            path, f"cannot be imported ({type(error).__name__}: {error})", "fix the file"
        ) from error
    method: Any = getattr(module, function, None)
    if not callable(method):
        raise file_error(
            path,
            f"has no function {function!r}",
            f"define `def {function}(scan): return legsim.correction.method.Correction(...)`",
        )
    own = cast(CorrectionMethod, method)

    def from_beside(scan: Scan) -> Correction:
        with own_code.importable(path):
            return own(scan)

    return from_beside
