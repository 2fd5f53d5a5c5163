"""Correction methods by name: the ones of the package, installed ones (entry points), and a user's own file."""

import importlib.metadata
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from legsim import artifacts, correction, mls, pose_estimation, projection_warp
from legsim.arrays import FloatArray
from legsim.correction import Correction, CorrectionMethod, Scan
from legsim.errors import LegsimError, at
from legsim.mls import AttachedPoint
from legsim.motions import ControlPointMotion
from legsim.opencl import Device
from legsim.pose_estimation import Scheme
from legsim.signals import RigidMotion, SegmentPoses

ENTRY_POINTS = "legsim.methods"
REFERENCE = "static"
"""the motion-free scan, which is no correction but what all are compared with"""
PAPER_ALPHA = 0.8
"""how far the hip and the ankle are drawn to the knee before they are projected (Maier et al., eq. 22 and 23)"""
_KNEE = 1
"""place of the knee among the joints"""


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """What the package's own methods are built from; only oracles look at the truth."""

    scheme: Scheme
    sensor: str
    """the one that rigid methods follow"""
    joints: tuple[AttachedPoint, ...]
    """hip, knee and ankle, each at the sensor that carries it: how the sensors were strapped on is known"""
    device: Device
    true_shank: RigidMotion


def _rigid(setup: Setup) -> CorrectionMethod:
    return correction.rigidly("rigid", lambda scan: correction.rigid_motion(scan.times, sensor_path(scan, setup.sensor, setup.scheme)))


def _rigid_printed_order(setup: Setup) -> CorrectionMethod:
    def estimate(scan: Scan, /) -> RigidMotion:
        return correction.rigid_motion(scan.times, sensor_path(scan, setup.sensor, setup.scheme), order="printed")

    return correction.rigidly("rigid-printed-order", estimate)


def followed_joints(scan: Scan, setup: Setup) -> ControlPointMotion:
    """Where hip, knee and ankle go by the two sensors' signals."""
    names = tuple(dict.fromkeys(joint.sensor for joint in setup.joints))
    poses = np.stack([sensor_path(scan, name, setup.scheme) for name in names], 1)
    return mls.follow(SegmentPoses(scan.times, names, poses), setup.joints)


def _nonrigid_2d(setup: Setup) -> CorrectionMethod:
    def correct(scan: Scan, /) -> Correction:
        near_knee = mls.drawn_to(followed_joints(scan, setup), _KNEE, PAPER_ALPHA)
        return Correction("nonrigid-2d", projection_warp.warp(scan.projections, near_knee, setup.device), None)

    return correct


def _nonrigid_3d(setup: Setup) -> CorrectionMethod:
    return lambda scan: Correction("nonrigid-3d", scan.projections, followed_joints(scan, setup))


BUILT_IN: dict[str, Callable[[Setup], CorrectionMethod]] = {
    "uncorrected": lambda _: correction.uncorrected,
    "oracle": lambda setup: correction.rigidly("oracle", correction.known(setup.true_shank)),
    "rigid": _rigid,
    "nonrigid-2d": _nonrigid_2d,
    "nonrigid-3d": _nonrigid_3d,
    "rigid-printed-order": _rigid_printed_order,
}


def sensor_path(scan: Scan, sensor: str, scheme: Scheme) -> FloatArray:
    """world_from_sensor (v, 4, 4) at the views, from that sensor's signals and its start."""
    rate, force = scan.signals.sensor(sensor)
    return pose_estimation.estimate(scan.signals.times, rate, force, scan.start(sensor), scan.times, scheme=scheme)


def build(name: str, setup: Setup) -> CorrectionMethod:
    """The method of that name: built in, an entry point of the group ``legsim.methods``, or ``path/to/file.py:function``.

    An entry point and a file's function are the method itself: called with a :class:`legsim.correction.Scan`.

    Raises:
        LegsimError: there is none; the line lists what there is.
    """
    if name in BUILT_IN:
        return BUILT_IN[name](setup)
    path, separator, function = name.rpartition(":")
    if separator and path.endswith(".py"):
        return _from_file(Path(path), function)
    installed = {point.name: point for point in importlib.metadata.entry_points(group=ENTRY_POINTS)}
    if name in installed:
        return installed[name].load()
    known = ", ".join([REFERENCE, *BUILT_IN, *installed])
    raise LegsimError(f"no correction method named {name!r}; there are: {known}, or your own as path/to/file.py:function")


def label(name: str) -> str:
    """What a method is called in tables and file names: its name, or the function's where it comes from a file."""
    return name.rpartition(":")[2]


def fingerprint(name: str) -> str:
    """Changes when a user's own file changes, so that a run knows to compute it again."""
    path, separator, _ = name.rpartition(":")
    return artifacts.sha256(Path(path)) if separator and Path(path).is_file() else name


def _from_file(path: Path, function: str) -> CorrectionMethod:
    if not path.is_file():
        raise at(path, "no such file", "give a method as path/to/file.py:function")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise at(path, "is not a Python file", "give a method as path/to/file.py:function")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    method = getattr(module, function, None)
    if not callable(method):
        raise at(path, f"has no function {function!r}", f"define `def {function}(scan): return legsim.correction.Correction(...)`")
    return cast(CorrectionMethod, method)
