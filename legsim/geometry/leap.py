"""LEAP's parameter files: a cone beam by its distances, or any detector by vectors.

LEAP's own `convert_conebeam_to_modularbeam` and `set_angles` define them
(github.com/LLNL/LEAP, src/parameters.cpp). With t = (cos, sin, 0) and p = (-sin, cos, 0) of the
angle less 90 degrees, the source stands at sod t - tau p, the detector's foot at (sod - sdd) t -
tau p, columns along p and rows along +z, both turned by tiltAngle about t; centerCol and centerRow
are the pixel at the foot. Lengths are in mm.
"""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from legsim.core.errors import file_error
from legsim.core.values import FloatArray, within
from legsim.geometry import astra
from legsim.geometry._file_parts import Given
from legsim.geometry.cone_beam import ConeBeamGeometry

_BEGIN = re.compile(r"^[ \t]*(?:proj_)?geometry[ \t]*=[ \t]*[a-zA-Z-]+[ \t]*$", re.M)

_NEWER = {
    "proj_geometry": "geometry",
    "proj_nangles": "numAngles",
    "proj_nrows": "numRows",
    "proj_ncols": "numCols",
    "proj_pheight": "pixelHeight",
    "proj_pwidth": "pixelWidth",
    "proj_crow": "centerRow",
    "proj_ccol": "centerCol",
    "proj_arange": "angularRange",
    "proj_phis": "phis",
    "proj_sod": "sod",
    "proj_sdd": "sdd",
    "proj_tau": "tau",
    "proj_helicalpitch": "helicalPitch",
    "proj_tiltAngle": "tiltAngle",
    "proj_srcpos": "sourcePositions",
    "proj_modcenter": "moduleCenters",
    "proj_rowvec": "rowVectors",
    "proj_colvec": "colVectors",
}
"""names of older files, and what they are called now"""


def is_leap(text: str) -> bool:
    """Whether a text is LEAP's, by its line on the kind of geometry."""
    return _BEGIN.search(text) is not None


def geometry(path: Path, text: str, given: Given) -> ConeBeamGeometry:
    """The geometry of a parameter file's text.

    Raises:
        LegsimError: another beam or a curved detector, a helix, missing parameters, numbers of
            other counts, or a detector other than was given.
    """
    stated: list[tuple[str, str]] = re.findall(r"^\s*(\w+)[ \t]*=[ \t]*(.*?)\s*$", text, re.M)
    values = {_NEWER.get(name, name): value for name, value in stated}
    kind = values["geometry"].lower()
    if kind not in ("cone", "modular") or values.get("detectorType", "flat") != "flat":
        curved = kind in ("cone", "modular")
        problem = "the detector is curved" if curved else f"the beam is {kind!r}"
        raise file_error(path, problem, "only cone beams on flat detectors are known")
    views, rows, columns = (
        int(_numbers(path, values, name, 1)[0]) for name in ("numAngles", "numRows", "numCols")
    )
    high, wide = (_numbers(path, values, name, 1)[0] for name in ("pixelHeight", "pixelWidth"))
    if min(views, rows, columns) < 1 or min(high, wide) <= 0:
        raise file_error(path, "a count or a pixel's size is not positive", "correct it there")
    shape_vu = given.shape(path, (rows, columns))
    given.pixel(path, (float(wide), float(high)))
    if kind == "modular":
        vectors = _of_modules(path, values, views, high, wide)
    else:
        vectors = _of_cone(path, values, (views, rows, columns), high, wide)
    return astra.geometry(path, vectors, Given(shape_vu, None, given.view_rate_hz))


def _of_modules(
    path: Path, values: Mapping[str, str], views: int, high: float, wide: float
) -> FloatArray:
    """(v, 12) of ASTRA from vectors: rows' and columns' have length 1."""
    source, middle, along_rows, along_columns = (
        _numbers(path, values, name, 3 * views).reshape(views, 3)
        for name in ("sourcePositions", "moduleCenters", "rowVectors", "colVectors")
    )
    return np.concatenate([source, middle, wide * along_columns, high * along_rows], axis=1)


def _of_cone(
    path: Path, values: Mapping[str, str], counts: tuple[int, int, int], high: float, wide: float
) -> FloatArray:
    """(v, 12) of ASTRA from distances and angles."""
    views, rows, columns = counts
    tau, pitch, tilt = (
        _numbers(path, values, name, 1)[0] if name in values else 0.0
        for name in ("tau", "helicalPitch", "tiltAngle")
    )
    if pitch != 0:
        cure = "only sources in one plane are known; convert it by LEAP's convert_to_modularbeam"
        raise file_error(path, "the source goes along a helix", cure, place="helicalPitch")
    row, column, source_origin, source_detector = (
        _numbers(path, values, name, 1)[0] for name in ("centerRow", "centerCol", "sod", "sdd")
    )
    if values.get("phis"):
        degrees = _numbers(path, values, "phis", views)
    else:
        degrees = np.arange(views) * _numbers(path, values, "angularRange", 1)[0] / views
    phi, tilt = np.radians(degrees) - 0.5 * np.pi, np.radians(tilt)
    zero = np.zeros(views)
    toward = np.stack([np.cos(phi), np.sin(phi), zero], -1)
    across = np.stack([-np.sin(phi), np.cos(phi), zero], -1)
    up = np.array([0.0, 0.0, 1.0])
    step_u = wide * (np.cos(tilt) * across + np.sin(tilt) * up)
    step_v = high * (np.cos(tilt) * up - np.sin(tilt) * across)
    source = source_origin * toward - tau * across
    middle = source - source_detector * toward
    middle = middle + (0.5 * (columns - 1) - column) * step_u
    middle = middle + (0.5 * (rows - 1) - row) * step_v
    return np.concatenate([source, middle, step_u, step_v], axis=1)


def _numbers(path: Path, values: Mapping[str, str], name: str, count: int) -> FloatArray:
    if name not in values:
        problem = f"lacks {name}"
        raise file_error(path, problem, "save it by LEAP's save_parameters")
    try:
        numbers = np.array([float(word) for word in values[name].split(",")])
    except ValueError as error:
        raise file_error(path, "is not of numbers", "correct it there", place=name) from error
    if len(numbers) != count or not within(numbers):
        problem = f"has {len(numbers)} numbers" if len(numbers) != count else "is too large"
        raise file_error(path, problem, f"expected {count}, all finite", place=name)
    return numbers
