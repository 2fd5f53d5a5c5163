"""Measured sensors beside predicted ones: the lag of their clocks, the mounting, and what is left.

The lag is where the rates of both agree best under any rotation: the sum of the singular values of
their cross-covariance, which no mounting changes. The mounting takes the mean specific force, which
is gravity in a person who stands or squats, onto the predicted one; the turn about it is that in
which the rates agree best.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from legsim.core import transforms
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.values import FloatArray
from legsim.imu.lag import find_far_lag, find_lag
from legsim.imu.recording import ImuRecording
from legsim.imu.shared_time import (
    HIGHEST,
    MOVEMENT_HZ,
    SHORTEST,
    Quantity,
    at,
    in_band,
    overlap,
    rms,
    shared_s,
)
from legsim.imu.worn_place import WornPlace, find_place

BANDS_HZ = (MOVEMENT_HZ, (6.0, 12.0), (12.0, 40.0))
"""movement; tissue and tremor; tissue and noise"""

LagSource = Literal["nearby", "anywhere", "stated"]
"""where a lag is from: searched around 0, over both recordings, or not searched"""

_QUANTITIES: tuple[Quantity, Quantity] = ("rate", "force")

_SURE, _BETTER = 0.7, 0.15
"""correlation below which lags far away are searched, and by which one of them must be higher"""

_TRUSTED = 0.4
"""correlation of the rates below which a lag or a turn is not known"""


@dataclass(frozen=True, slots=True, eq=False)
class BandAgreement:
    """RMS of the vector in one band, and how alike both are."""

    quantity: Quantity
    """"rate" (deg/s) or "force" (mg)"""
    band_hz: tuple[float, float]
    measured: float
    predicted: float
    difference: float
    """RMS of the difference after lag and mounting"""
    correlation: float


@dataclass(frozen=True, slots=True, eq=False)
class SensorComparison:
    """One measured sensor beside the predicted one."""

    predicted: ImuRecording
    measured: ImuRecording
    """by the predicted one's clock, in its frame"""
    lag: float
    """s, the sensor's clock minus the markers', beyond the offset that was known"""
    predicted_from_measured: FloatArray
    """(3, 3) from the sensor's own axes to the predicted sensor's"""
    correlation: float
    """of the rates in the lowest band at that lag, in the best rotation"""
    bands: tuple[BandAgreement, ...]
    mean_rate: FloatArray
    """(3,) rad/s, mean of measured minus predicted in the sensor's axes: the gyroscope's bias"""
    lag_source: LagSource
    """"anywhere" since a lag nearby does not agree; "stated" in what is too short for a search"""
    place: WornPlace
    """where on the segment the accelerometer fits better"""
    shared_s: float
    """s that both recorded, at that lag"""
    turn_spread: float
    """rad, one standard deviation of the mounting's turn about the vertical; 0 where it is given"""

    @property
    def misfit(self) -> float:
        """By how much the rates agree less in the mounting than in the rotation that fits best."""
        return self.correlation - self.bands[0].correlation

    @property
    def trusted(self) -> bool:
        """Whether the rates agree enough for lag and turn to be known."""
        return self.correlation >= _TRUSTED


def compare(
    predicted: ImuRecording,
    measured: ImuRecording,
    *,
    rotation: FloatArray | None = None,
    clock_stated: bool = False,
) -> SensorComparison:
    """Sets a measured sensor beside the predicted one of the same place.

    Args:
        predicted: as the markers have it, by their clock.
        measured: by its own clock; a known offset is taken off already.
        rotation: (3, 3) predicted_from_measured where the mounting is known; None estimates it.
        clock_stated: whether the offset is known, so that recordings that share less than 3 s can
            be compared. No lag is searched in these.

    Raises:
        LegsimError: recordings that overlap by less than 3 s (0.5 s where the clock is stated).
    """
    step = 1 / min(predicted.rate_hz, measured.rate_hz)
    lag, correlation, source = _lag(predicted, measured, step, clock_stated=clock_stated)
    on_time, spread = measured.shifted(-lag), 0.0
    if rotation is None:
        mounting = find_mounting(predicted, on_time, step=step)
        rotation, spread = mounting.predicted_from_measured, mounting.spread
    turned = ImuRecording(
        measured.name,
        on_time.times,
        on_time.angular_velocity @ rotation.T,
        on_time.specific_force @ rotation.T,
        measured.notes,
    )
    bands = tuple(
        agreement
        for quantity in _QUANTITIES
        for band in BANDS_HZ
        if (agreement := _agreement(predicted, turned, quantity, band)) is not None
    )
    times = overlap(predicted, turned, step)
    ours, theirs = (at(r, times, "rate").mean(0) for r in (predicted, turned))
    bias = rotation.T @ (theirs - ours)
    place = find_place(predicted, turned, step=step)
    return SensorComparison(
        predicted, turned, lag, rotation, correlation, bands, bias, source, place,
        shared_s(predicted, turned), spread,
    )  # fmt: skip


def _lag(
    predicted: ImuRecording, measured: ImuRecording, step: float, *, clock_stated: bool
) -> tuple[float, float, LagSource]:
    """Lag (s), correlation, and where they are from.

    Raises:
        LegsimError: recordings that neither overlap nor agree anywhere.
    """
    if shared_s(predicted, measured) < SHORTEST:
        if clock_stated and shared_s(predicted, measured) > 0:
            return (*find_lag(predicted, measured, step=step, reach=0.0), "stated")
        found = find_far_lag(predicted, measured, step=step)
        if found is not None:
            return (*found, "anywhere")
    lag, correlation = find_lag(predicted, measured, step=step)
    if correlation < _SURE:
        found = find_far_lag(predicted, measured, step=step)
        if found is not None and found[1] > correlation + _BETTER:
            return (*found, "anywhere")
    return lag, correlation, "nearby"


@dataclass(frozen=True, slots=True, eq=False)
class Mounting:
    """How a measured sensor is turned against the predicted one."""

    predicted_from_measured: FloatArray
    """(3, 3)"""
    spread: float
    """rad of its turn about the vertical, one standard deviation, by leaving out each eighth of
    the recording; its tilt is by gravity
    """


_BLOCKS = 8


def find_mounting(predicted: ImuRecording, measured: ImuRecording, *, step: float) -> Mounting:
    """Finds the mounting by gravity, and by the rates about it.

    Raises:
        LegsimError: an overlap of less than 0.5 s.
    """
    times = overlap(predicted, measured, step)
    up, seen = (_unit(at(r, times, "force").mean(0)) for r in (predicted, measured))
    level = _smallest_turn(seen, up)
    ours, theirs = (in_band(r, times, MOVEMENT_HZ, "rate") for r in (predicted, measured))
    theirs = theirs @ level.T
    flat_ours, flat_theirs = (v - np.outer(v @ up, up) for v in (ours, theirs))
    both = np.stack([np.cross(flat_theirs, flat_ours) @ up, (flat_theirs * flat_ours).sum(-1)], -1)
    angle = np.arctan2(*both.sum(0))
    parts = np.array_split(both, _BLOCKS)
    left_out = np.array([np.arctan2(*(both.sum(0) - part.sum(0))) for part in parts]) - angle
    # the jackknife's variance, of turns by the shorter way
    left_out = np.arctan2(np.sin(left_out), np.cos(left_out))
    spread = float(np.sqrt((_BLOCKS - 1) * left_out.var()))
    return Mounting(transforms.axis_rotation(up, np.array(angle)) @ level, spread)


def _smallest_turn(start: FloatArray, end: FloatArray) -> FloatArray:
    """The rotation (3, 3) of unit vectors ``start`` to ``end`` by the smallest angle."""
    axis = np.cross(start, end)
    sine, cosine = float(np.linalg.norm(axis)), float(start @ end)
    if sine < 1e-9:  # opposite or equal: any axis across
        axis = np.cross(start, np.eye(3)[int(np.argmin(np.abs(start)))])
    return transforms.axis_rotation(axis, np.array(np.arctan2(sine, cosine)))


def _unit(vector: FloatArray) -> FloatArray:
    return vector / np.linalg.norm(vector)


def _agreement(
    predicted: ImuRecording, measured: ImuRecording, quantity: Quantity, band: tuple[float, float]
) -> BandAgreement | None:
    """The numbers of one band; None where either samples too slowly for it."""
    slower = min(predicted.rate_hz, measured.rate_hz)
    if band[0] >= HIGHEST * slower:
        return None
    times = overlap(predicted, measured, 1 / slower)
    ours, theirs = (in_band(r, times, band, quantity) for r in (predicted, measured))
    unit = np.degrees(1.0) if quantity == "rate" else 1e3 / STANDARD_GRAVITY
    power = np.sqrt((ours**2).sum() * (theirs**2).sum())
    return BandAgreement(
        quantity,
        band,
        *(float(unit) * rms(v) for v in (theirs, ours, theirs - ours)),
        correlation=float((ours * theirs).sum() / power) if power > 0 else 0.0,
    )
