"""Correction methods by name: the ones of the package, installed ones (entry points), and a user's
own file.
"""

import importlib.metadata
import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.correction import bead_tracking, control_points, image_warp, rigid
from legsim.correction import method as correction_method
from legsim.correction.bead_scan import BeadScan
from legsim.correction.control_points import AttachedPoint
from legsim.correction.method import Correction, CorrectionMethod, Scan
from legsim.correction.rigid import sensor_path
from legsim.deformation.models import ControlPointMotion, FieldMotion, RigidMotion
from legsim.geometry.volume import VolumeGrid
from legsim.imu.strapdown import Scheme
from legsim.kinematics.skeleton import SegmentPoses
from legsim.opencl.device import Device

ENTRY_POINTS = "legsim.methods"

REFERENCE = "static"
"""the motion-free scan, which is no correction but what all are compared with"""

PAPER_ALPHA = 0.8
"""how far the hip and the ankle are drawn to the knee before they are projected (Maier et al., eq.
22 and 23)
"""

_KNEE = 1
"""place of the knee among a leg's points"""

_RIGID_FROM = "rigid@"


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """What the package's own methods are built from; only oracles look at the truth."""

    scheme: Scheme
    sensor: str
    """the one that rigid methods follow"""
    legs: tuple[tuple[AttachedPoint, ...], ...]
    """hip, knee, ankle and whatever else is followed, a leg each, at the sensors that carry them:
    how those were strapped on is known
    """
    device: Device
    nodes: VolumeGrid
    """coarse, over the volume: of displacement fields"""
    true_shank: RigidMotion
    true_field: Callable[[], FieldMotion]
    """the phantom's own motion at the nodes, computed when it is asked for"""
    beads: Callable[[], BeadScan]
    """the same scan with beads on the skin, exposed when it is asked for"""


def _rigid(setup: Setup) -> CorrectionMethod:
    return rigid.from_estimator(
        "rigid",
        lambda scan: rigid.rigid_motion(scan.times, sensor_path(scan, setup.sensor, setup.scheme)),
    )


def _rigid_paper_order(setup: Setup) -> CorrectionMethod:
    def estimate(scan: Scan, /) -> RigidMotion:
        return rigid.rigid_motion(
            scan.times, sensor_path(scan, setup.sensor, setup.scheme), order="paper"
        )

    return rigid.from_estimator("rigid-paper-order", estimate)


def followed(scan: Scan, setup: Setup) -> tuple[ControlPointMotion, ...]:
    """Where each leg's points go by the sensors' signals.

    Raises:
        LegsimError: no leg has all of its sensors.
    """
    if not setup.legs:
        raise LegsimError(
            "non-rigid methods follow hip, knee and ankle: configure a sensor on femur_l and one "
            "on tibia_l (imu.sensors)"
        )
    names = tuple(dict.fromkeys(point.sensor for leg in setup.legs for point in leg))
    poses = np.stack([sensor_path(scan, name, setup.scheme) for name in names], 1)
    return tuple(
        control_points.track_points(SegmentPoses(scan.times, names, poses), leg)
        for leg in setup.legs
    )


def _together(motions: Sequence[ControlPointMotion]) -> ControlPointMotion:
    reference, moved = (
        np.concatenate([m.reference for m in motions]),
        np.concatenate([m.moved for m in motions], 1),
    )
    return ControlPointMotion(motions[0].times, reference, moved)


def _nonrigid_2d(setup: Setup) -> CorrectionMethod:
    def correct(scan: Scan, /) -> Correction:
        near_knees = _together(
            [control_points.contracted(leg, _KNEE, PAPER_ALPHA) for leg in followed(scan, setup)]
        )
        return Correction(
            "nonrigid-2d",
            image_warp.warp_images(scan.projections, near_knees, setup.device),
            None,
            warped_by=near_knees,
        )

    return correct


def _nonrigid_3d(setup: Setup) -> CorrectionMethod:
    def correct(scan: Scan, /) -> Correction:
        motion = _together(followed(scan, setup))
        # the device's closed form is for three points; any other number is sampled
        whole = motion if len(motion.reference) == 3 else motion.on_grid(setup.nodes)
        return Correction("nonrigid-3d", scan.projections, whole)

    return correct


def _marker_based(setup: Setup) -> CorrectionMethod:
    def correct(scan: Scan, /) -> Correction:
        beads = setup.beads()
        pixels = bead_tracking.track(beads.projections, beads.guesses, radius=beads.radius)
        found = bead_tracking.estimate(scan.projections.geometry, pixels)
        note = (
            f"{len(beads.guesses)} beads of {2e3 * beads.radius:g} mm: "
            f"{100 * found.used.mean():.0f} % of their shadows were found and "
            f"believed, {found.residual_px:.2f} px RMS from a rigid motion."
        )
        return Correction("marker-based", scan.projections, found.motion, notes=(note,))

    return correct


def _oracle_nonrigid(setup: Setup) -> CorrectionMethod:
    return lambda scan: Correction("oracle-nonrigid", scan.projections, setup.true_field())


BUILT_IN: dict[str, Callable[[Setup], CorrectionMethod]] = {
    "uncorrected": lambda _: rigid.uncorrected,
    "oracle": lambda setup: rigid.from_estimator("oracle", rigid.known(setup.true_shank)),
    "oracle-nonrigid": _oracle_nonrigid,
    "marker-based": _marker_based,
    "rigid": _rigid,
    "nonrigid-2d": _nonrigid_2d,
    "nonrigid-3d": _nonrigid_3d,
    "rigid-paper-order": _rigid_paper_order,
}


def find(name: str) -> Callable[[Setup], CorrectionMethod]:
    """What builds the method of that name: built in, an entry point of the group
    ``legsim.methods``, or ``path/to/file.py:function``.

    ``rigid@<sensor>`` is the rigid correction from that sensor, whichever the setup names.
    An entry point and a file's function are the method itself: called with a
    :class:`legsim.correction.method.Scan`.

    Raises:
        LegsimError: there is none; the line lists what there is.
    """
    if name in BUILT_IN:
        return BUILT_IN[name]
    sensor = rigid_sensor(name)
    if sensor is not None:
        return lambda setup: _rigid(replace(setup, sensor=sensor))
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
        f"no correction method named {name!r}; there are: {known}, or your own as "
        "path/to/file.py:function"
    )


def build(name: str, setup: Setup) -> CorrectionMethod:
    """The method of that name; errors as in :func:`find`."""
    return find(name)(setup)


def rigid_sensor(name: str) -> str | None:
    """The sensor that a name such as ``rigid@thigh_l`` asks for; None for other names."""
    return name.removeprefix(_RIGID_FROM) if name.startswith(_RIGID_FROM) else None


def label(name: str) -> str:
    """What a method is called in tables and file names: its name, or the function's where it comes
    from a file.
    """
    return name.rpartition(":")[2]


def fingerprint(name: str) -> str:
    """Changes when the file of a user's own method changes, so that a run knows to compute it
    again.
    """
    path, separator, _ = name.rpartition(":")
    if separator and Path(path).is_file():
        return files.sha256(Path(path))
    module = next(
        (
            p.module
            for p in importlib.metadata.entry_points(group=ENTRY_POINTS)
            if p.name == name and name not in BUILT_IN
        ),
        None,
    )
    spec = None if module is None else importlib.util.find_spec(module)
    return files.sha256(Path(spec.origin)) if spec is not None and spec.origin is not None else name


def _installed(point: importlib.metadata.EntryPoint) -> CorrectionMethod:
    try:
        method = point.load()
    except Exception as error:
        problem = (
            f"method {point.name}: {point.value} cannot be loaded ({type(error).__name__}: {error})"
        )
        raise LegsimError(f"{problem}; mend or remove the package that offers it") from error
    if not callable(method):
        raise LegsimError(
            f"method {point.name}: {point.value} is not a function; name one in "
            f'[project.entry-points."{ENTRY_POINTS}"]'
        )
    return cast(CorrectionMethod, method)


def _from_file(path: Path, function: str) -> CorrectionMethod:
    if not path.is_file():
        raise file_error(path, "no such file", "give a method as path/to/file.py:function")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise file_error(path, "is not a Python file", "give a method as path/to/file.py:function")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise file_error(
            path, f"cannot be imported ({type(error).__name__}: {error})", "mend the file"
        ) from error
    method = getattr(module, function, None)
    if not callable(method):
        raise file_error(
            path,
            f"has no function {function!r}",
            f"define `def {function}(scan): return legsim.correction.method.Correction(...)`",
        )
    return cast(CorrectionMethod, method)
