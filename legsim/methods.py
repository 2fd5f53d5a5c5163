"""Correction methods by name: the ones of the package, installed ones (entry points), and a user's own file."""

import importlib.metadata
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from legsim import artifacts, correction, pose_estimation
from legsim.arrays import FloatArray
from legsim.correction import CorrectionMethod, Scan
from legsim.errors import LegsimError, at
from legsim.pose_estimation import Scheme
from legsim.signals import RigidMotion

ENTRY_POINTS = "legsim.methods"
REFERENCE = "static"
"""the motion-free scan, which is no correction but what all are compared with"""


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """What the package's own methods are built from; only oracles look at the truth."""

    scheme: Scheme
    sensor: str
    true_shank: RigidMotion


def _rigid(setup: Setup) -> CorrectionMethod:
    return correction.rigidly("rigid", lambda scan: correction.rigid_motion(scan.times, sensor_path(scan, setup.sensor, setup.scheme)))


def _rigid_printed_order(setup: Setup) -> CorrectionMethod:
    def estimate(scan: Scan, /) -> RigidMotion:
        return correction.rigid_motion(scan.times, sensor_path(scan, setup.sensor, setup.scheme), order="printed")

    return correction.rigidly("rigid-printed-order", estimate)


BUILT_IN: dict[str, Callable[[Setup], CorrectionMethod]] = {
    "uncorrected": lambda _: correction.uncorrected,
    "oracle": lambda setup: correction.rigidly("oracle", correction.known(setup.true_shank)),
    "rigid": _rigid,
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
