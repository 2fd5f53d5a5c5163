"""RTK's geometry XML, read and written to the same meaning, in millimeters.

RTK's nine parameters per view were checked against RTK 2.7: with R = Rz(-in plane) Rx(-out of
plane) Ry(-gantry), s the source offset and o the detector offset, its matrix is [[-SDD, 0, sx -
ox], [0, -SDD, sy - oy], [0, 0, 1]] [R | (-sx, -sy, -SID)], in mm on the detector. Pixel (0, 0) of a
centered detector lies at -(n - 1)/2 pixels from that origin.
"""

import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from legsim.core import transforms
from legsim.core.errors import file_error
from legsim.core.values import FloatArray, within
from legsim.geometry._file_parts import (
    BY_NUMBERS,
    NEEDS_DETECTOR,
    Given,
    count_of,
    geometry_of,
    matrices_mm,
    numbers_of,
    pixel_of,
    refuse_mirrored,
    refuse_other_pixels,
)
from legsim.geometry.cone_beam import ConeBeamGeometry

_PARAMETERS = (
    *(
        "GantryAngle",
        "SourceToIsocenterDistance",
        "SourceToDetectorDistance",
        "SourceOffsetX",
        "SourceOffsetY",
    ),
    *("ProjectionOffsetX", "ProjectionOffsetY", "InPlaneAngle", "OutOfPlaneAngle"),
)


def _matrix(parameters: dict[str, float]) -> FloatArray:
    """(3, 4) of one view, world mm to mm on the detector."""
    gantry, in_plane, out_of_plane = (
        np.deg2rad(parameters[name]) for name in ("GantryAngle", "InPlaneAngle", "OutOfPlaneAngle")
    )
    source = np.array(
        [
            parameters["SourceOffsetX"],
            parameters["SourceOffsetY"],
            parameters["SourceToIsocenterDistance"],
        ]
    )
    distance = parameters["SourceToDetectorDistance"]
    rotation = _turn("z", -in_plane) @ _turn("x", -out_of_plane) @ _turn("y", -gantry)
    offset = source[:2] - (parameters["ProjectionOffsetX"], parameters["ProjectionOffsetY"])
    camera = np.array([[-distance, 0, offset[0]], [0, -distance, offset[1]], [0, 0, 1]])
    return camera @ np.column_stack([rotation, -source])


def _turn(axis: str, angle: float) -> FloatArray:
    return transforms.axis_rotation(np.eye(3)["xyz".index(axis)], angle)


def _parameters(matrix_mm: FloatArray) -> list[float]:
    """RTK's numbers, as in ``_PARAMETERS``, nearest to a matrix (3, 4) from world mm to detector
    mm.
    """
    # third row of unit length and w negative in front, as RTK has it
    matrix = -matrix_mm / np.linalg.norm(matrix_mm[2, :3])
    third = matrix[2, :3]
    foot_u, foot_v = matrix[0, :3] @ third, matrix[1, :3] @ third
    row_u, row_v = matrix[0, :3] - foot_u * third, matrix[1, :3] - foot_v * third
    distance = 0.5 * (np.linalg.norm(row_u) + np.linalg.norm(row_v))
    # the rotation nearest to axes that a calibration leaves a little skewed
    left, _, right = np.linalg.svd(np.stack([-row_u / distance, -row_v / distance, third]))
    rotation = left @ right
    source = rotation @ -np.linalg.solve(matrix[:, :3], matrix[:, 3])
    if abs(rotation[2, 1]) < 1 - 1e-12:
        gantry, in_plane = (
            np.arctan2(rotation[2, 0], rotation[2, 2]),
            np.arctan2(rotation[0, 1], rotation[1, 1]),
        )
    else:  # looking along the axis of rotation: only the sum of the two angles is determined
        gantry, in_plane = -np.arctan2(rotation[0, 2], rotation[0, 0]), 0.0
    out_of_plane = -np.arctan2(rotation[2, 1], np.hypot(rotation[0, 1], rotation[1, 1]))
    angles = np.rad2deg([gantry, in_plane, out_of_plane])
    offsets = (source[0] - foot_u, source[1] - foot_v)
    return [
        float(x)
        for x in (
            angles[0] % 360.0,
            source[2],
            distance,
            source[0],
            source[1],
            *offsets,
            angles[1],
            angles[2],
        )
    ]


def _millimeters_from_pixels(
    shape_vu: tuple[int, int], pixel_mm: tuple[float, float]
) -> FloatArray:
    """(3, 3) from pixel coordinates to mm on a detector whose middle is the origin."""
    (rows, columns), (wide, high) = shape_vu, pixel_mm
    return np.array(
        [[wide, 0, -wide * (columns - 1) / 2], [0, high, -high * (rows - 1) / 2], [0, 0, 1]]
    )


def text_of(path: Path, geometry: ConeBeamGeometry) -> str:
    """A geometry as RTK's XML; a comment keeps what RTK has no place for.

    Raises:
        LegsimError: views that RTK cannot express; the line names ``path``.
    """
    refuse_mirrored(path, "RTK", geometry)
    rows, columns = geometry.shape_vu
    pixel_mm = (geometry.pixel_pitch * 1e3, geometry.row_pitch() * 1e3)
    note = json.dumps(
        {
            "columns": columns,
            "rows": rows,
            "pixel_mm": pixel_mm[0] if pixel_mm[0] == pixel_mm[1] else list(pixel_mm),
            "times_s": geometry.times.tolist(),
        }
    )
    lines = [
        '<?xml version="1.0"?>',
        "<!DOCTYPE RTKGEOMETRY>",
        '<RTKThreeDCircularGeometry version="3">',
        f"  <!-- legsim {note} -->",
    ]
    on_detector = _millimeters_from_pixels(geometry.shape_vu, pixel_mm)
    all_parameters = [_parameters(matrix) for matrix in on_detector @ matrices_mm(geometry)]
    all_written = np.array(
        [_matrix(dict(zip(_PARAMETERS, numbers, strict=True))) for numbers in all_parameters]
    )
    refuse_other_pixels(path, "RTK", geometry, np.linalg.inv(on_detector) @ all_written)
    for parameters, written in zip(all_parameters, all_written, strict=True):
        lines += ["  <Projection>"]
        lines += [
            f"    <{name}>{value!r}</{name}>"
            for name, value in zip(_PARAMETERS, parameters, strict=True)
        ]
        lines += [
            "    <Matrix>",
            *("      " + " ".join(repr(x) for x in row) for row in written.tolist()),
            "    </Matrix>",
        ]
        lines += ["  </Projection>"]
    return "\n".join([*lines, "</RTKThreeDCircularGeometry>", ""])


def geometry(path: Path, root: ElementTree.Element, given: Given) -> ConeBeamGeometry:
    """The geometry of a parsed file; errors as of :func:`legsim.geometry.files.read_geometry`."""
    # RTK itself reads both: version 3 adds the curved detector, which is refused below
    if root.tag != "RTKThreeDCircularGeometry" or root.get("version") not in ("2", "3"):
        found = f"<{root.tag} version={root.get('version')!r}>"
        raise file_error(
            path,
            f"begins with {found}",
            'only RTK\'s <RTKThreeDCircularGeometry version="3"> (or "2") and CONRAD\'s <java> are '
            "known; RTK makes its own of Varian's (rtkvarianobigeometry) and Elekta's "
            f"(rtkelektasynergygeometry); of others {BY_NUMBERS}",
        )
    note = _legsim_note(path, root)
    by_images = given.shape_vu is not None and (given.pixel_mm or given.header_pixel_mm)
    if note is None or by_images:
        # RTK's numbers are in mm on the detector: they hold for any pixels on it
        shape_vu, pixel_mm = given.shape(path, None), given.pixel(path, None)
    else:
        shape_vu = given.shape(path, (note["rows"], note["columns"]))
        pixel_mm = given.pixel(path, note["pixel_mm"])
    if pixel_mm is None and given.shape_vu is not None:
        raise file_error(
            path, "does not say how large its pixels are", "give the pixel size (pixel_mm) in mm"
        )
    if pixel_mm is None:
        raise file_error(
            path, "does not say how large the detector and its pixels are", NEEDS_DETECTOR
        )
    matrices, by_parameters = _matrices(path, root)
    times = given.times(len(matrices)) if note is None else note["times_s"]
    if len(times) != len(matrices):
        raise file_error(
            path,
            f"legsim's comment has {len(times)} times for {len(matrices)} projections",
            "restore or remove it",
            place="comment",
        )
    return geometry_of(
        path,
        times,
        # RTK's depths are negative in front of the source
        np.linalg.inv(_millimeters_from_pixels(shape_vu, pixel_mm)) @ -matrices,
        shape_vu,
        pixel_mm[0],
        sides_stated=by_parameters,
    )


def _legsim_note(path: Path, root: ElementTree.Element) -> dict[str, Any] | None:
    """Reads legsim's comment: RTK's format has no place for the detector and the times."""
    for element in root:
        text = (element.text or "").strip()
        if element.tag is ElementTree.Comment and text.startswith("legsim {"):
            try:
                note = json.loads(text.removeprefix("legsim "))
            except (json.JSONDecodeError, RecursionError) as error:
                raise file_error(
                    path,
                    f"legsim's comment is not JSON ({getattr(error, 'msg', error)})",
                    "restore or remove it",
                    place="comment",
                ) from error
            if not {"rows", "columns", "pixel_mm", "times_s"} <= set(note):
                return None
            counts = {key: count_of(path, note, key) for key in ("rows", "columns")}
            return {
                **counts,
                "pixel_mm": pixel_of(path, note["pixel_mm"]),
                "times_s": numbers_of(path, note["times_s"], "times_s"),
            }
    return None


def _matrices(path: Path, root: ElementTree.Element) -> tuple[FloatArray, bool]:
    """((v, 3, 4), whether parameters say them all).

    As in RTK, parameters start at 0 and stay until given again.
    """
    parameters, given, matrices = dict.fromkeys(_PARAMETERS, 0.0), set[str](), []
    by_parameters = True
    for element in root:
        if element.tag == "Projection":
            matrices.append(_view(path, element, parameters, given, f"projection {len(matrices)}"))
            by_parameters = by_parameters and bool(given)
        elif isinstance(element.tag, str):
            _read_parameter(path, element, parameters, given, "before the projections")
    if not matrices:
        raise file_error(path, "holds no <Projection>", "a geometry needs one per view")
    return np.array(matrices), by_parameters


def _view(
    path: Path,
    element: ElementTree.Element,
    parameters: dict[str, float],
    given: set[str],
    place: str,
) -> FloatArray:
    stated = None
    for child in element:
        if child.tag == "Matrix":
            stated = _numbers(path, child, place, 12).reshape(3, 4)
        elif isinstance(child.tag, str):
            _read_parameter(path, child, parameters, given, place)
    if stated is not None and not given:
        return stated
    if "SourceToIsocenterDistance" in given and parameters["SourceToDetectorDistance"] == 0:
        raise file_error(
            path,
            "SourceToDetectorDistance is 0, RTK's parallel beam",
            "only cone beams are known; give the distance",
            place=place,
        )
    # a matrix beside them shows that a negative distance is meant: the origin is behind the source
    meant = stated is not None and "SourceToIsocenterDistance" in given
    if not (
        (parameters["SourceToIsocenterDistance"] > 0 or meant)
        and parameters["SourceToDetectorDistance"] > 0
    ):
        raise file_error(
            path,
            "source distances are missing or not positive",
            "give SourceToIsocenterDistance and SourceToDetectorDistance",
            place=place,
        )
    matrix = _matrix(parameters)
    if stated is not None and np.abs(stated - matrix).max() > 1e-6 * np.abs(matrix).max():
        raise file_error(
            path, "its <Matrix> contradicts its parameters", "remove one of them", place=place
        )
    return matrix


def _read_parameter(
    path: Path,
    element: ElementTree.Element,
    parameters: dict[str, float],
    given: set[str],
    place: str,
) -> None:
    """Takes one of the nine parameters; refuses a curved detector; ignores collimation."""
    if element.tag in parameters:
        parameters[element.tag] = float(_numbers(path, element, place, 1)[0])
        given.add(element.tag)
    elif element.tag == "RadiusCylindricalDetector" and _numbers(path, element, place, 1)[0] != 0:
        raise file_error(
            path, "the detector is cylindrical", "only flat detectors are known", place=place
        )
    elif element.tag not in (
        "RadiusCylindricalDetector",
        "CollimationUInf",
        "CollimationUSup",
        "CollimationVInf",
        "CollimationVSup",
    ):
        raise file_error(
            path,
            f"unknown element <{element.tag}>",
            f"known are {', '.join(_PARAMETERS)} and Matrix",
            place=place,
        )


def _numbers(path: Path, element: ElementTree.Element, place: str, count: int) -> FloatArray:
    words: Sequence[str] = (element.text or "").split()
    try:
        values = np.array([float(word) for word in words])
    except ValueError as error:
        raise file_error(
            path,
            f"<{element.tag}> holds {' '.join(words)[:40]!r}",
            f"expected {count} numbers",
            place=place,
        ) from error
    if len(values) != count or not within(values):
        raise file_error(
            path,
            f"<{element.tag}> holds {len(values)} numbers",
            f"expected {count}, all finite and none too large for a geometry",
            place=place,
        )
    return values
