"""Units of a table's columns: as somebody says, as the table states, or as its names hint; and
names that say another quantity.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.imu import units
from legsim.imu.table_layout import TableLayout
from legsim.imu.table_rows import Column
from legsim.mocap.labels import without_shared_ends

ByColumn = Mapping[Column, str | None]
"""a unit per column; None where none is said"""


_FORCE = re.compile(r"acc(?![ou]|\.? to\b)", re.I)
"""in names of the columns of accelerations, not "according to" """

_RATE = re.compile(r"gyr|\bangular|omega", re.I)
"""in names of those of angular velocities"""

_PUSHES = re.compile(rf"{_FORCE.pattern}|(?<![a-z])a[xyz](?![a-z])", re.I)
_TURNS = re.compile(rf"{_RATE.pattern}|pitch|roll|yaw|(?<![a-z])[gwr][xyz](?![a-z])", re.I)
"""in names of either beside words of the other, as Delsys' "IM ACC Pitch1", or "ACC1_wx" of a
sensor that is called so
"""


_FREE = re.compile(
    r"(?<!bias.)(?<!drift.)(?<!noise.)(?<!offset.)free[ _.]?acc|user[ _.]?acc|without g\b|"
    r"(without|w/?o|no|minus|excluding)[ _-]?gravity(?![ _-]*(comp|corr|remov|subtr))|"
    r"gravity[ _-]?(free|removed|compensated)", re.I)  # fmt: skip
"""in names of accelerations without gravity: Xsens' FreeAcc_X, Apple's userAcceleration, phyphox'
"without g"
"""

_LINEAR = re.compile(r"lin(ear)?[ _.]?acc", re.I)
"""in names of these (Android, phyphox), and of specific force (ROS)"""

_WITH_GRAVITY = "give the columns of the accelerometer's own readings, or export these"

_LEFT = 0.3
"""of the median magnitude: what gravity leaves in the mean over a leg's movements, at least"""

_ALIKE, _MOST = 0.1, 0.5
"""of the median magnitude, by which most samples of a sensor that is turned about differ at most"""


def check_names(
    forces: Sequence[Column], rates: Sequence[Column], names: Mapping[Column, str]
) -> None:
    """Refuses columns that are given as accelerations (``forces``) or as angular velocities and
    are called like those of the other, as where they are counted from the wrong one on, and
    accelerations that are called free of gravity.

    Both have three columns a sensor, in one order.

    Raises:
        LegsimError: names the column.
    """
    for column in forces:
        if _FREE.search(names.get(column, "")):
            raise LegsimError(
                f"column {column!r} is an acceleration without gravity by its name "
                f"({names[column]!r}), no specific force; {_WITH_GRAVITY}"
            )
    names = _own_names(forces, rates, names)
    for columns, quantity, own, other in (
        (forces, "an acceleration", _PUSHES, _RATE),
        (rates, "an angular velocity", _TURNS, _FORCE),
    ):
        for column in columns:
            name = names.get(column, "")
            if other.search(name) and not own.search(name):
                but = "its name says otherwise" if name == column else f"its name is {name!r}"
                raise LegsimError(
                    f"column {column!r} is given as {quantity}, and {but}; correct the columns, or "
                    "their names in the table"
                )


def check_gravity(
    columns: Sequence[Column], names: Mapping[Column, str], force: FloatArray
) -> None:
    """Refuses accelerations (n, 3) in m/s^2 that are called linear and hold no gravity: their mean
    is near nothing beside their magnitudes, and these are not alike, as those of a sensor are that
    is turned about. In another unit both hold too, which is not judged here.

    Raises:
        LegsimError: names the first of the ``columns``.
    """
    called = [column for column in columns if _LINEAR.search(names.get(column, ""))]
    seen = force[np.isfinite(force).all(-1)]
    if not called or not len(seen):
        return
    sizes = np.linalg.norm(seen, axis=-1)
    usual, left = np.median(sizes), np.linalg.norm(seen.mean(0))
    alike = (np.abs(sizes - usual) <= _ALIKE * usual).mean()
    if left < _LEFT * usual and alike < _MOST:
        raise LegsimError(
            f"column {called[0]!r} is an acceleration without gravity: its sensor reads "
            f"{left:.2g} m/s2 in the mean, and {usual:.2g} m/s2 in the median; {_WITH_GRAVITY}"
        )


def _own_names(
    forces: Sequence[Column], rates: Sequence[Column], names: Mapping[Column, str]
) -> Mapping[Column, str]:
    """Names without what all of a sensor share, as a device that is called Gyro, where the rest
    says which are the angular velocities: "Gyro X" and "Gyro RX".
    """
    own = dict(names)
    for k in range(0, len(forces) if len(forces) == len(rates) else 0, 3):
        columns = [*forces[k : k + 3], *rates[k : k + 3]]
        rest = without_shared_ends([names.get(column, "") for column in columns])
        if all(_TURNS.search(name) for name in rest[len(columns) // 2 :]):
            own |= zip(columns, rest, strict=True)
    return own


def force_scale(layout: TableLayout, stated: ByColumn, hints: ByColumn) -> float:
    """m/s^2 per number of the accelerations' columns: as the layout says, the table states, or the
    ends of all names hint.

    Raises:
        LegsimError: a unit that is none, that contradicts the layout, or several.
    """
    if layout.counts_per_g is not None:
        return STANDARD_GRAVITY / layout.counts_per_g
    usual = _hint(hints, units.ACCELERATION) or "m/s2"
    unit = _unit("acceleration_unit", layout.acceleration_unit, usual, stated)
    return _factor(unit, units.ACCELERATION, "acceleration")


def rate_scale(layout: TableLayout, stated: ByColumn, hints: ByColumn) -> float:
    """rad/s per number of the angular velocities' columns, as for :func:`force_scale`."""
    if layout.counts_per_deg_per_s is not None:
        return units.ANGULAR_VELOCITY["deg/s"] / layout.counts_per_deg_per_s
    usual = _hint(hints, units.ANGULAR_VELOCITY) or "rad/s"
    given = layout.angular_velocity_unit
    unit = _unit("angular_velocity_unit", given, usual, stated)
    return _factor(unit, units.ANGULAR_VELOCITY, "angular velocity")


def _hint(hints: ByColumn, known: Mapping[Any, float]) -> str | None:
    """The unit of one quantity at the end of all names; None where they have none, or several."""
    found = set(hints.values())
    unit = found.pop() if len(found) == 1 else None
    return unit if unit in known else None


def _unit(setting: str, given: str | None, default: str, stated: ByColumn) -> str:
    """The unit of the columns, as given, else as the table states it, else the default."""
    for column, own in stated.items():
        if own is not None and given is None and not units.is_known(own):
            raise LegsimError(
                f"column {column!r} is stated to be in {own!r}, which is no unit that is read; "
                f"state {setting}, or convert it"
            )
        if own is not None and given is not None and own != given and units.is_known(own):
            raise LegsimError(
                f"column {column!r} is stated to be in {own}, but {setting} is {given}; correct "
                "one of them"
            )
    there = {own for own in stated.values() if own and units.is_known(own)}
    if len(there) > 1:
        raise LegsimError(
            f"columns of one quantity are in {' and '.join(sorted(there))}; read their "
            "sensors by a TOML each"
        )
    return given or next(iter(there), None) or default


def _factor(unit: str, factors: Mapping[Any, float], quantity: str) -> float:
    if unit not in factors:
        raise LegsimError(
            f"the columns of the {quantity} are stated to be in {unit}; check which columns they "
            "are"
        )
    return factors[unit]
