"""What no scanner is like: geometries in another unit, with distances exchanged, off the axis."""

import numpy as np

from legsim.geometry.cone_beam import ConeBeamGeometry

_SOURCE_TO_CENTER = (0.02, 20.0)
"""m: from the smallest benchtop scanner to more than any room"""

_AT_THE_EDGE = 0.05
"""of the detector's rows: nearer to an edge the rotation center is off the detector's middle by a
mistake
"""

_SAME_PLACE = 1e-6
"""of the source's distance, below which two views are from one place"""

_ROUND = (150.0, 400.0)
"""degrees that scans turn by"""


def objections(geometry: ConeBeamGeometry, *, pixel_known: bool = True) -> tuple[str, ...]:
    """Lines on what is doubtful about a geometry, with the fix; none where nothing is.

    Args:
        geometry: of any scan.
        pixel_known: whether its pixel size is one; without it nothing says how far the detector is.
    """
    found = [_unit(geometry), _behind(geometry) if pixel_known else None]
    if len(geometry) > 1:
        found += [_center(geometry), _repeated(geometry), _radians(geometry)]
    return tuple(line for line in found if line)


def _arms(geometry: ConeBeamGeometry) -> np.ndarray:
    """(v, 3) m from the rotation center to the sources."""
    return geometry.sources() - geometry.rotation_center()


def _unit(geometry: ConeBeamGeometry) -> str | None:
    if len(geometry) < 2:
        return None
    arm = float(np.median(np.linalg.norm(_arms(geometry), axis=-1)))
    if _SOURCE_TO_CENTER[0] <= arm <= _SOURCE_TO_CENTER[1]:
        return None
    return (
        f"the sources are {1e3 * arm:.3g} mm from the rotation center: is the geometry in another "
        "unit? give all lengths in mm"
    )


def _behind(geometry: ConeBeamGeometry) -> str | None:
    """Doubts a detector that stands between source and rotation center."""
    center = geometry.rotation_center()
    depth = geometry.matrices[:, 2, :3] @ center + geometry.matrices[:, 2, 3]
    detector = geometry.focal_lengths() * geometry.pixel_pitch
    if not (detector < 0.999 * depth).all() or len(geometry) < 2:
        return None
    return (
        f"the detector is {1e3 * np.median(detector):.4g} mm from the source, nearer than the "
        f"rotation center at {1e3 * np.median(depth):.4g} mm: check the distances (source to "
        "detector, not center to detector) and the pixel size"
    )


def _center(geometry: ConeBeamGeometry) -> str | None:
    """Doubts a detector that does not see the rotation center.

    At one side of the columns it may stand for a half fan, so that only rows are held to more.
    """
    rows, columns = geometry.shape_vu
    u, v = np.median(geometry.project(geometry.rotation_center()[None])[0][:, 0], axis=0)
    margin = _AT_THE_EDGE * rows - 0.5
    if -0.5 <= u <= columns - 0.5 and margin <= v <= rows - 1 - margin:
        return None
    return (
        f"the rotation center is seen at column {u:.4g}, row {v:.4g} of {columns} x {rows} pixels: "
        "is the geometry that of a detector with other pixels (unbinned, in mm, counted from its "
        "middle)?"
    )


def _repeated(geometry: ConeBeamGeometry) -> str | None:
    sources = geometry.sources()
    steps = np.linalg.norm(np.diff(sources, axis=0), axis=-1)
    same = np.flatnonzero(steps < _SAME_PLACE * np.linalg.norm(_arms(geometry), axis=-1).mean())
    if not len(same):
        return None
    return (
        f"{len(same)} views are from the same place as the one before, the first of them view "
        f"{same[0] + 1}: check the angles, or take out views that are there twice"
    )


def _radians(geometry: ConeBeamGeometry) -> str | None:
    """Doubts a turn of some degrees whose number of degrees as radians is that of a scan."""
    arms = _arms(geometry)
    arms /= np.linalg.norm(arms, axis=-1, keepdims=True)
    between = np.clip((arms[1:] * arms[:-1]).sum(-1), -1.0, 1.0)
    turned = float(np.degrees(np.arccos(between).sum()))
    if len(geometry) < 8 or not _ROUND[0] <= np.degrees(turned) <= _ROUND[1]:
        return None
    return (
        f"the source turns by {turned:.3g} deg in all, which would be {np.degrees(turned):.0f} deg "
        "if the angles were in radians: give them in degrees"
    )
