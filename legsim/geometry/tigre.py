"""TIGRE's geometries: distances, offsets and angles, as JSON of its Python object's attributes.

TIGRE's own kernels define them. Before any turn the source stands at (DSO, 0, 0) and the detector's
middle at (-(DSD - DSO), 0, 0), columns along +y and rows along +z. ``rotDetector`` (about x, y, z)
turns the detector about its middle by Rz Ry Rx, ``offDetector`` (along v, u) then shifts it, the
angles (alpha, theta, psi) turn source and detector by Rz(alpha) Ry(theta) Rz(psi), and ``COR``
shifts both by COR (-sin alpha, cos alpha, 0). Lengths are in mm, angles in rad. ``nDetector`` and
``dDetector`` are (rows, columns) and (between rows, between columns).

MATLAB's struct says the same columns first: ``nDetector``, ``dDetector`` and ``offDetector`` are
(u, v) there, and what differs by view has a column, not a row, for each.

``offOrigin`` moves the volume, not the scanner, and is not used here.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from legsim.core import transforms
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray, within
from legsim.geometry._file_parts import (
    Given,
    geometry_of,
    refuse_mirrored,
    refuse_other_pixels,
)
from legsim.geometry.cone_beam import ConeBeamGeometry

_PAIRS, _TRIPLES = ("nDetector", "dDetector", "offDetector"), ("rotDetector", "angles")
"""parameters of two and of three numbers, for all views or for each"""

_NEEDED = ("DSD", "DSO", "nDetector", "dDetector", "angles")


def is_tigre(content: object) -> bool:
    """Whether a JSON file's content is TIGRE's, by its keys."""
    return isinstance(content, dict) and {"DSD", "DSO"} <= content.keys()


def from_object(geo: Any, angles: ArrayLike | None = None) -> ConeBeamGeometry:
    """The geometry of TIGRE's Python object, or of anything with the same attributes.

    Args:
        geo: `tigre.geometry()`; nothing of TIGRE is imported.
        angles: (v,) or (v, 3) rad, where the object does not hold them.

    Raises:
        LegsimError: a parallel beam, missing attributes, or numbers of other counts.
    """
    content = {name: value for name, value in vars(geo).items() if value is not None}
    if angles is not None:
        content["angles"] = np.asarray(angles, float)
    return geometry("TIGRE's geometry", content, Given())


def in_python_order(
    path: Path, content: Mapping[str, Any], given: Given
) -> tuple[Mapping[str, Any], tuple[str, ...]]:
    """(parameters in the order of TIGRE's Python, notes) of a file that Python or MATLAB wrote.

    MATLAB's are told by a column for each view, or by the images' columns and rows; where nothing
    tells and the order matters, it is taken as Python's, with a note.
    """
    values = {
        name: _numbers(path, content[name], name)
        for name in (*_PAIRS, *_TRIPLES)
        if name in content
    }
    tables = {name: value.shape for name, value in values.items() if value.ndim == 2}
    across = any(
        rows == (2 if name in _PAIRS else 3) and columns > 3
        for name, (rows, columns) in tables.items()
    )
    along = any(rows > 3 for rows, _ in tables.values())
    detector = tuple(values["nDetector"].ravel().tolist()) if "nDetector" in values else ()
    by_images = given.shape_vu not in (None, detector) and given.shape_vu == detector[::-1]
    if not along and (across or by_images):
        turned = {name: value.T if value.ndim == 2 else value for name, value in values.items()}
        turned |= {name: turned[name][..., ::-1] for name in _PAIRS if name in turned}
        return {**content, **turned}, (
            f"{path.name}: read as TIGRE's MATLAB struct, whose detector is (columns, rows)",
        )
    told = along or (given.shape_vu is not None and given.shape_vu != given.shape_vu[::-1])
    if told or all(np.ptp(values[name]) == 0 for name in _PAIRS if name in values):
        return content, ()
    return content, (
        f"{path.name}: nDetector, dDetector and offDetector are taken as (rows, columns), as of "
        "TIGRE's Python; if MATLAB wrote them, exchange the two numbers of each",
    )


def geometry(path: Path | str, content: Mapping[str, Any], given: Given) -> ConeBeamGeometry:
    """The geometry of TIGRE's parameters that were read from ``path``; errors as
    :func:`from_object`.
    """
    missing = [name for name in _NEEDED if name not in content]
    if missing:
        cure = f"TIGRE's geometry has {', '.join(_NEEDED)}"
        if missing == ["angles"]:
            cure = "add them, in radians: geo.angles = angles before it is written"
        raise file_error(path, f"lacks {', '.join(missing)}", cure)
    if str(content.get("mode", "cone")) not in ("cone", "None"):
        raise file_error(
            path, f"the beam is {content['mode']!r}", "only cone beams are known", place="mode"
        )
    angles = _angles(path, content["angles"])
    views = len(angles)
    rows, columns = (int(n) for n in _per_view(path, content, "nDetector", 1, 2)[0])
    pitch_v, pitch_u = _per_view(path, content, "dDetector", 1, 2)[0]
    shape_vu = given.shape(Path(path), (rows, columns))
    given.pixel(Path(path), (pitch_u, pitch_v))
    source_origin, source_detector, center = (
        _per_view(path, content, name, views, 1)[:, 0] for name in ("DSO", "DSD", "COR")
    )
    offsets = _per_view(path, content, "offDetector", views, 2)
    turns = _per_view(path, content, "rotDetector", views, 3)
    if min(rows, columns, pitch_u, pitch_v) <= 0 or (source_detector <= 0).any():
        raise file_error(
            path, "a size or distance is not positive", "correct DSD, nDetector, dDetector"
        )
    turned = _turn("z", angles[:, 0]) @ _turn("y", angles[:, 1]) @ _turn("z", angles[:, 2])
    detector = _turn("z", turns[:, 2]) @ _turn("y", turns[:, 1]) @ _turn("x", turns[:, 0])
    alpha = angles[:, 0]
    shift = center[:, None] * np.stack([-np.sin(alpha), np.cos(alpha), 0 * alpha], -1)
    zero = np.zeros(views)
    source = np.einsum("vij,vj->vi", turned, np.stack([source_origin, zero, zero], -1)) + shift
    middle = np.stack([source_origin - source_detector, offsets[:, 1], offsets[:, 0]], -1)
    middle = np.einsum("vij,vj->vi", turned, middle) + shift
    axes = turned @ detector
    step_u, step_v = pitch_u * axes[:, :, 1], pitch_v * axes[:, :, 2]
    first = middle - 0.5 * (columns - 1) * step_u - 0.5 * (rows - 1) * step_v
    back = np.stack([step_u, step_v, first - source], -1)
    if (np.abs(np.linalg.det(back)) <= 1e-12 * np.prod(np.linalg.norm(back, axis=1), -1)).any():
        problem = "in a view the detector's plane holds the source"
        raise file_error(path, problem, "correct DSD, DSO, dDetector and rotDetector")
    forward = np.linalg.inv(back)
    matrices = np.concatenate([forward, -np.einsum("vij,vj->vi", forward, source)[..., None]], -1)
    return geometry_of(
        Path(path), given.times(views), matrices, shape_vu, float(pitch_u), sides_stated=True
    )


def _angles(path: Path | str, value: Any) -> FloatArray:
    """(v, 3) alpha, theta, psi in rad."""
    angles = _numbers(path, value, "angles")
    if angles.ndim == 1:
        angles = np.stack([angles, 0 * angles, 0 * angles], -1)
    if angles.ndim != 2 or angles.shape[1] != 3 or not len(angles):
        raise file_error(
            path,
            f"angles have the shape {angles.shape}",
            "expected one or three (z, y, z) per view",
            place="angles",
        )
    if np.abs(angles).max() > 8 * np.pi:
        raise file_error(
            path,
            f"an angle is {np.abs(angles).max():g} rad, over four turns",
            "TIGRE's angles are in radians; convert them",
            place="angles",
        )
    return angles


def _per_view(
    path: Path | str, content: Mapping[str, Any], name: str, views: int, count: int
) -> FloatArray:
    """(views, count) of a value that is one for all views or one per view; 0 where left out."""
    value = _numbers(path, content.get(name, np.zeros(count)), name)
    if value.size == count:
        return np.broadcast_to(value.reshape(1, count), (views, count))
    if value.size == views * count and value.shape[0] == views:
        return value.reshape(views, count)
    if value.size == views * count and value.shape == (1, views):
        return value.reshape(views, count)
    raise file_error(
        path,
        f"has the shape {value.shape}",
        f"expected {count} number{'s' * (count > 1)}, or as many for each of {views} views",
        place=name,
    )


def _numbers(path: Path | str, value: Any, name: str) -> FloatArray:
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError, OverflowError) as error:
        raise file_error(path, "is not of numbers", "correct it there", place=name) from error
    if not within(numbers):
        problem = "holds numbers that are not finite or too large for a geometry"
        raise file_error(path, problem, "correct it", place=name)
    return numbers


def _turn(axis: str, angles: FloatArray) -> FloatArray:
    return transforms.axis_rotation(np.eye(3)["xyz".index(axis)], angles)


def parameters_of(path: Path, geometry: ConeBeamGeometry) -> dict[str, Any]:
    """TIGRE's parameters of a geometry, in mm and rad; errors name ``path``.

    Raises:
        LegsimError: a mirrored view, a source at the world's origin or one that looks away from it,
            or pixels that TIGRE cannot say (skewed, or of other shapes by view).
    """
    refuse_mirrored(path, "TIGRE", geometry)
    pitch_u, pitch_v = 1e3 * geometry.pixel_pitch, 1e3 * geometry.row_pitch()
    axes = _detector_axes(geometry)
    sources = 1e3 * geometry.sources()
    distances = np.linalg.norm(sources, axis=1)
    if distances.min() <= 1e-9:
        raise file_error(
            path,
            f"view {int(np.argmin(distances))} has its source at the world's origin",
            "TIGRE turns the source about the origin; move the world's origin",
        )
    turned = _gantry_axes(sources / distances[:, None], axes[:, :, 2])
    middle = np.einsum("vji,vj->vi", turned, _middles_mm(geometry))
    if (away := middle[:, 0] >= distances).any():
        raise file_error(
            path,
            f"view {int(np.argmax(away))} looks away from world's origin",
            "TIGRE turns the source about the origin and puts the detector behind it: move world's "
            "origin to the isocenter, or write legsim JSON, matrices or ASTRA's vectors",
        )
    detector = np.swapaxes(turned, 1, 2) @ axes
    content = {
        "mode": "cone",
        "DSD": (distances - middle[:, 0]).tolist(),
        "DSO": distances.tolist(),
        "nDetector": list(geometry.shape_vu),
        "dDetector": [pitch_v, pitch_u],
        "sDetector": [pitch_v * geometry.shape_vu[0], pitch_u * geometry.shape_vu[1]],
        "offDetector": middle[:, [2, 1]].tolist(),
        "rotDetector": _angles_xyz(detector).tolist(),
        "COR": [0.0] * len(geometry),
        "angles": _angles_zyz(turned).tolist(),
    }
    refuse_other_pixels(path, "TIGRE", geometry, tigre_matrices(content))
    return content


def tigre_matrices(content: Mapping[str, Any]) -> FloatArray:
    """(v, 3, 4) in meters of TIGRE's parameters."""
    return geometry("TIGRE's geometry", content, Given()).matrices


def text_of(path: Path, geometry: ConeBeamGeometry) -> str:
    """TIGRE's parameters as JSON; errors as :func:`parameters_of`."""
    lines = (f"{json.dumps(k)}: {json.dumps(v)}" for k, v in parameters_of(path, geometry).items())
    return "{" + ",\n".join(lines) + "}\n"


def _detector_axes(geometry: ConeBeamGeometry) -> FloatArray:
    """(v, 3, 3) world axes: towards the source, along columns' steps and rows' steps."""
    back = np.linalg.inv(geometry.matrices[:, :, :3])
    along_u, along_v = (
        back[:, :, k] / np.linalg.norm(back[:, :, k], axis=1)[:, None] for k in (0, 1)
    )
    axes = np.stack([-geometry.matrices[:, 2, :3], along_u, along_v], -1)
    # the rotation nearest to axes that a calibration leaves a little skewed
    left, _, right = np.linalg.svd(axes)
    return np.asarray(left @ right, float)


def _middles_mm(geometry: ConeBeamGeometry) -> FloatArray:
    """(v, 3) world mm of the detector's middle."""
    rows, columns = geometry.shape_vu
    back = np.linalg.inv(geometry.matrices[:, :, :3])
    depth = geometry.pixel_pitch / np.linalg.norm(back[:, :, 0], axis=1)
    middle: FloatArray = np.array([0.5 * (columns - 1), 0.5 * (rows - 1), 1.0])
    to_middle = back @ middle
    return 1e3 * (geometry.sources() + depth[:, None] * to_middle)


def _gantry_axes(toward_source: FloatArray, along_rows: FloatArray) -> FloatArray:
    """(v, 3, 3) rotations: x to the source, z as near as can be to the direction of the rows'
    steps.
    """
    z = along_rows - (along_rows * toward_source).sum(1, keepdims=True) * toward_source
    length = np.linalg.norm(z, axis=1, keepdims=True)
    if length.min() < 1e-6:
        raise LegsimError("the detector's columns point at its source; correct the geometry")
    z /= length
    y = np.asarray(np.cross(z, toward_source), np.float64)
    return np.stack([toward_source, y, z], -1)


def _angles_zyz(turned: FloatArray) -> FloatArray:
    """(v, 3) alpha, theta, psi of Rz(alpha) Ry(theta) Rz(psi); psi is 0 where only a sum counts."""
    theta = np.arctan2(np.hypot(turned[:, 0, 2], turned[:, 1, 2]), turned[:, 2, 2])
    upright = np.hypot(turned[:, 0, 2], turned[:, 1, 2]) < 1e-9
    alpha = np.where(
        upright,
        np.arctan2(-turned[:, 0, 1], turned[:, 1, 1]),
        np.arctan2(turned[:, 1, 2], turned[:, 0, 2]),
    )
    psi = np.where(upright, 0.0, np.arctan2(turned[:, 2, 1], -turned[:, 2, 0]))
    return np.stack([alpha, theta, psi], -1)


def _angles_xyz(detector: FloatArray) -> FloatArray:
    """(v, 3) angles about x, y, z of Rz Ry Rx."""
    y = np.arctan2(-detector[:, 2, 0], np.hypot(detector[:, 0, 0], detector[:, 1, 0]))
    x = np.arctan2(detector[:, 2, 1], detector[:, 2, 2])
    z = np.arctan2(detector[:, 1, 0], detector[:, 0, 0])
    return np.stack([x, y, z], -1)
