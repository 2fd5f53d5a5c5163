"""Joints of a measured scan, on the sensors that carry them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from legsim.config.measured_scan import JointConfig
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.correction.control_points import AttachedPoint

_JOINTS = ("hip", "knee", "ankle")


@dataclass(frozen=True, slots=True)
class MeasuredJoints:
    """What SCAN.toml says of joints."""

    legs: tuple[tuple[AttachedPoint, ...], ...]
    """hip, knee, ankle and further points of each leg, as the non-rigid methods take them"""
    ankles: tuple[AttachedPoint, ...]
    """of legs of which nothing else is known"""
    knees: dict[str, FloatArray]
    """the knee (3,) m in a thigh's sensor, by its name"""


def on_sensors(
    given: Sequence[JointConfig], sensors: Sequence[str], segments: Mapping[str, str], where: str
) -> MeasuredJoints:
    """Joints by the legs that they are of.

    Args:
        given: joints.
        sensors: names of those with a start.
        segments: that sensors are worn on, by their names; empty where it is not said.
        where: the file, for messages.

    Raises:
        LegsimError: a joint is on no sensor with a start, an ankle on no shank of its leg, is
            there twice, or a leg is not whole.
    """
    for joint in given:
        if joint.sensor not in sensors:
            have = ", ".join(sensors) or "none"
            raise LegsimError(
                f"{where} (joints): {joint.name} is on {joint.sensor!r}, which has no start; "
                f"sensors with one: {have}"
            )
        _check_segment(joint, segments.get(joint.sensor, ""), where)
    named = Counter(joint.name for joint in given)
    sides = dict.fromkeys(joint.name[-1:] for joint in given)
    alone = [s for s in sides if [n for n in named if n[-1:] == s] == [f"ankle_{s}"]]
    for side in sides:
        own = [f"{joint}_{side}" for joint in _JOINTS]
        lacking = [name for name in own if name not in named]
        if lacking and side not in alone:
            raise LegsimError(
                f"{where} (joints): {lacking[0]} is missing; a leg needs {', '.join(own)}, or "
                f"its {own[2]} alone"
            )
    thighs = {joint.name[-1:]: joint.sensor for joint in given if joint.name[:-2] == "hip"}
    knees, once = {}, []
    for joint in given:
        on_thigh = joint.name[:-2] == "knee" and joint.sensor == thighs[joint.name[-1:]]
        if on_thigh and named[joint.name] == 2:
            knees[joint.sensor] = 1e-3 * np.array(joint.position_mm)
        else:
            once.append(joint)
    known = {joint.name: _attached(joint) for joint in once}
    if len(known) < len(once) or len(once) + len(knees) < len(given):
        raise LegsimError(
            f"{where}: a joint is there twice; keep one of each name, and of a knee one on the "
            "shank's sensor and one on the thigh's"
        )
    legs = []
    for side in sides:
        if side in alone:
            continue
        own = [f"{joint}_{side}" for joint in _JOINTS]
        names = own + [n for n in known if n.endswith(f"_{side}") and n not in own]
        legs.append(tuple(known[name] for name in names))
    ankles = tuple(known[f"ankle_{side}"] for side in alone)
    return MeasuredJoints(tuple(legs), ankles, knees)


def _check_segment(joint: JointConfig, segment: str, where: str) -> None:
    """Refuses an ankle on a thigh or on the other leg: a foot would hold what it does not."""
    shank = f"tibia_{joint.name[-1:]}"
    if joint.name[:-2] == "ankle" and segment and segment != shank:
        raise LegsimError(
            f"{where} (joints): {joint.name} is on sensor {joint.sensor!r}, which is worn on "
            f"{segment}; an ankle is a place on {shank}: correct the joint's sensor, or the "
            "sensor's segment"
        )


def _attached(joint: JointConfig) -> AttachedPoint:
    return AttachedPoint(joint.sensor, 1e-3 * np.array(joint.position_mm))
