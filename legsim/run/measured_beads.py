"""Beads on the skin of a measured scan: what shows the motion of which sensor's segment."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from legsim.config.measured_scan import MeasuredBeadsConfig
from legsim.core.errors import LegsimError, file_error
from legsim.correction.articulated import scanned_leg
from legsim.correction.articulated_beads import BeadedLeg
from legsim.correction.bead_scan import BeadScan, shadows_of
from legsim.correction.bead_tracking import FEWEST
from legsim.correction.path_measurements import BeadShadows
from legsim.correction.triangulation import triangulated
from legsim.run import shadow_files
from legsim.run.measured import MeasuredScan, followed

_FEWEST_BY_HAND = 2
"""views that give a bead its place in space"""


def of_sensor(scan: MeasuredScan, sensor: str) -> Callable[[], BeadShadows] | None:
    """What finds the shadows of the beads on a sensor's segment; None without any.

    Raises:
        LegsimError: a file that cannot be used.
    """
    seen = [_seen(scan, one) for one in scan.settings.beads if _on(scan, one) == sensor]
    return (lambda: _together(seen).enough()) if seen else None


def of_all(scan: MeasuredScan) -> Callable[[], BeadShadows] | None:
    """What finds the shadows of all beads, for marker-based, which takes them for one rigid body;
    None without any.

    Raises:
        LegsimError: a file that cannot be used, or too few beads for a pose.
    """
    seen = [_seen(scan, one) for one in scan.settings.beads]
    if not seen:
        return None
    shown = np.sum([_shown(one, len(scan.seen.times)) for one in seen], axis=0)
    if shown.min() < FEWEST:
        named = ", ".join(one.file for one in scan.settings.beads)
        raise LegsimError(
            f"{named}: view {int(np.argmin(shown))} shows {int(shown.min())} beads; marker-based "
            f"needs {FEWEST} or more in every view: give the pixels of more, or track them"
        )
    return lambda: _together(seen)


def of_leg(scan: MeasuredScan) -> BeadedLeg | None:
    """Beads on the thigh and the shank of the scanned leg; None where something lacks.

    Raises:
        LegsimError: a file that cannot be used.
    """
    if lacking(scan):
        return None
    thigh, shank = _segments(scan)
    beads = {name: of_sensor(scan, name) for name in (thigh, shank)}

    def shown(sensor: str) -> BeadShadows:
        made = beads[sensor]
        assert made is not None  # else something lacks
        return made()

    return BeadedLeg(shown, scan.knees_on_thighs[thigh])


def lacking(scan: MeasuredScan) -> str:
    """What articulated-beads needs of beads and joints that the scan does not have; empty where it
    has all.
    """
    thigh, shank = _segments(scan)
    there = {_on(scan, one) for one in scan.settings.beads}
    without = [name for name in (thigh, shank) if name not in there]
    if without:
        return (
            f"articulated-beads needs beads on the segment of sensor {' and '.join(without)}: give "
            f'the pixels of their shadows as [[beads]] with sensor = "{without[0]}" in SCAN.toml'
        )
    if thigh not in scan.knees_on_thighs:
        return (
            f"articulated-beads needs the knee on the thigh's sensor, too: give it in SCAN.toml as "
            f'a second [[joints]] of the knee, with sensor = "{thigh}"'
        )
    return ""


def doubts(scan: MeasuredScan) -> list[str]:
    """Sentences on pixels that images or geometry speak against."""
    projections, said = scan.seen.projections, []
    for one in scan.settings.beads:
        path = scan.folder / one.file
        pixels = shadow_files.load_beads(path, projections.geometry)
        said += shadow_files.doubts(path, "bead", pixels, projections)
    return said


def _segments(scan: MeasuredScan) -> tuple[str, str]:
    """The sensors of the scanned leg's thigh and shank."""
    hip, knee = scanned_leg(scan.seen)[:2]
    return hip.sensor, knee.sensor


def _on(scan: MeasuredScan, beads: MeasuredBeadsConfig) -> str:
    """The sensor whose segment carries the beads."""
    return beads.sensor or followed(scan)


def _seen(scan: MeasuredScan, given: MeasuredBeadsConfig) -> BeadShadows | BeadScan:
    """The beads of one file."""
    path, geometry = scan.folder / given.file, scan.seen.projections.geometry
    pixels = shadow_files.load_beads(path, geometry)
    if not given.track:
        return BeadShadows(pixels, given.error_px)
    counts = np.isfinite(pixels).all(-1).sum(0)
    if counts.min() < _FEWEST_BY_HAND:
        raise file_error(
            path,
            f"bead {int(np.argmin(counts))} is there in {counts.min()} view",
            f"give each bead in {_FEWEST_BY_HAND} views or more, far apart; the others are tracked",
        )
    guesses = triangulated(geometry, pixels)
    return BeadScan(scan.seen.projections, guesses, 0.5e-3 * given.diameter_mm, given.error_px)


def _shown(beads: BeadShadows | BeadScan, views: int) -> NDArray[np.intp]:
    """How many beads each view (views,) shows, or may show where they are tracked."""
    if isinstance(beads, BeadScan):
        return np.full(views, len(beads.guesses))
    return np.asarray(np.isfinite(beads.pixels).all(-1).sum(1))


def _together(seen: Sequence[BeadShadows | BeadScan]) -> BeadShadows:
    """The beads of several files, with the largest of their errors."""
    found = [shadows_of(one) for one in seen]
    pixels = np.concatenate([one.pixels for one in found], axis=1)
    return BeadShadows(pixels, max(one.error_px for one in found))
