"""Geometry files: legsim's JSON, RTK's XML and plain 3x4 matrices, all in millimeters, read and
written to the same meaning.

RTK's nine parameters a view were checked against RTK 2.7: with R = Rz(-in plane) Rx(-out of plane)
Ry(-gantry), s the source offset and o the detector offset, its matrix is [[-SDD, 0, sx - ox], [0,
-SDD, sy - oy], [0, 0, 1]] [R | (-sx, -sy, -SID)], in mm on the detector. Pixel (0, 0) of a centered
detector lies at -(n - 1)/2 pixels from that origin.
"""

import json
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from legsim.core import files, transforms
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry

SUFFIXES = (".json", ".xml", ".txt", ".npy")

_RTK_PARAMETERS = (
    *(
        "GantryAngle",
        "SourceToIsocenterDistance",
        "SourceToDetectorDistance",
        "SourceOffsetX",
        "SourceOffsetY",
    ),
    *("ProjectionOffsetX", "ProjectionOffsetY", "InPlaneAngle", "OutOfPlaneAngle"),
)

_LARGEST = float(np.finfo(float).max)

_MOST_PIXELS = 1 << 20
"""in a row or column; more is no detector"""

_NEEDS_DETECTOR = (
    "give the detector's rows and columns (and its pixel_mm), which this kind of file does not hold"
)


def load_geometry(
    path: Path | str,
    *,
    columns: int | None = None,
    rows: int | None = None,
    pixel_mm: float | None = None,
    view_rate_hz: float = 31.0,
) -> ConeBeamGeometry:
    """Reads a geometry; the suffix says which kind: .json (legsim), .xml (RTK), .txt or .npy (a 3x4
    matrix a view, mm to pixels).

    Args:
        columns, rows: pixels of the detector, for files that do not say; RTK's XML then has its
            detector centered.
        pixel_mm: pixel pitch, for files that do not say; RTK's XML is in mm on the detector and
            cannot be read without it.
        view_rate_hz: views a second, for files without times.

    Raises:
        LegsimError: the file is missing, of another kind or malformed, or what it leaves open was
            not given.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise file_error(
            path,
            f"unknown kind of geometry {path.suffix!r}",
            f"name it with one of {', '.join(SUFFIXES)}",
        )
    if (columns is None) != (rows is None):
        raise LegsimError("a detector needs both columns and rows; give the other one too")
    shape_vu = None if columns is None or rows is None else (rows, columns)
    try:
        if path.suffix.lower() == ".json":
            return _load_json(path)
        if path.suffix.lower() == ".xml":
            return _load_rtk(path, shape_vu, pixel_mm, view_rate_hz)
        return _load_matrices(path, shape_vu, pixel_mm, view_rate_hz)
    except OSError as error:
        raise file_error(
            path, f"cannot be read ({error.strerror or error})", "check the path"
        ) from error
    except UnicodeDecodeError as error:
        raise file_error(path, "is not text", "check that it is a geometry") from error


def save_geometry(path: Path | str, geometry: ConeBeamGeometry) -> None:
    """Writes a geometry; the suffix says which kind, as in :func:`load_geometry`.

    The file appears whole or not at all.

    Raises:
        LegsimError: an unknown suffix, a file that cannot be written, or views that RTK cannot
            express (skewed, mirrored, not square).
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise file_error(
            path,
            f"unknown kind of geometry {path.suffix!r}",
            f"name it with one of {', '.join(SUFFIXES)}",
        )
    if suffix == ".npy":
        with files.whole(path) as partial:
            np.save(partial, _matrices_mm(geometry))
    else:
        text = (
            _json_text(geometry)
            if suffix == ".json"
            else _rtk_text(path, geometry)
            if suffix == ".xml"
            else _plain_text(geometry)
        )
        files.write_text(path, text)


def _matrices_mm(geometry: ConeBeamGeometry) -> FloatArray:
    """(v, 3, 4): world mm to (u w, v w, w), w in mm."""
    return geometry.matrices * np.array([1.0, 1.0, 1.0, 1e3])


def _geometry(
    path: Path,
    times: Any,
    matrices_mm: Any,
    shape_vu: tuple[int, int],
    pixel_mm: float | None,
    place: str = "",
) -> ConeBeamGeometry:
    """Checked by the value type; its complaints get the file's name."""
    try:
        matrices = np.asarray(matrices_mm, float) * np.array([1.0, 1.0, 1.0, 1e-3])
        return ConeBeamGeometry(
            times, matrices, shape_vu, 1e-3 if pixel_mm is None else pixel_mm * 1e-3
        )
    except LegsimError as error:
        raise file_error(path, str(error), "correct the file", place=place) from error


# legsim JSON
# --------------------------------------------------------------------------------------------------


def _json_text(geometry: ConeBeamGeometry) -> str:
    rows, columns = geometry.shape_vu
    head = {
        "unit": "mm",
        "columns": columns,
        "rows": rows,
        "pixel_mm": geometry.pixel_pitch * 1e3,
        "times_s": geometry.times.tolist(),
    }
    lines = ",\n".join(
        json.dumps(matrix) for matrix in _matrices_mm(geometry).reshape(-1, 12).tolist()
    )
    return json.dumps(head)[:-1] + ', "matrices": [\n' + lines + "\n]}\n"


def _load_json(path: Path) -> ConeBeamGeometry:
    try:
        content = json.loads(path.read_text("utf-8-sig"))
    except json.JSONDecodeError as error:
        raise file_error(
            path,
            f"is not JSON ({error.msg})",
            "correct it there",
            place=f"line {error.lineno}, column {error.colno}",
        ) from error
    except RecursionError as error:
        raise file_error(
            path, "nests lists too deeply", "give one flat list of 12 numbers a view"
        ) from error
    if not isinstance(content, dict):
        raise file_error(
            path,
            "holds no object",
            'expected {"unit": "mm", "columns": ..., "rows": ..., "times_s": [...], "matrices": '
            "[...]}",
        )
    missing = [
        key for key in ("unit", "columns", "rows", "times_s", "matrices") if key not in content
    ]
    if missing:
        raise file_error(
            path,
            f"lacks {', '.join(missing)}",
            'expected the keys "unit", "columns", "rows", "times_s", "matrices"',
        )
    if content["unit"] != "mm":
        raise file_error(
            path, f"the unit is {content['unit']!r}", 'only "mm" is known', place="unit"
        )
    shape_vu = (_count(path, content, "rows"), _count(path, content, "columns"))
    pixel_mm = content.get("pixel_mm")
    if pixel_mm is not None and not (_is_number(pixel_mm) and pixel_mm > 0):
        raise file_error(
            path,
            f"{pixel_mm!r} is not a positive number",
            "give the pixel pitch in mm or leave it out",
            place="pixel_mm",
        )
    times = _numbers(path, content["times_s"], "times_s")
    matrices = content["matrices"]
    if not isinstance(matrices, list) or not matrices:
        raise file_error(
            path,
            "is not a list of matrices",
            "give one list of 12 numbers a view",
            place="matrices",
        )
    rows = [_numbers(path, matrix, f"matrices[{k}]", 12) for k, matrix in enumerate(matrices)]
    if len(rows) != len(times):
        raise file_error(
            path,
            f"there are {len(rows)} matrices but {len(times)} times",
            "give one of each a view",
            place="times_s",
        )
    return _geometry(path, times, np.reshape(rows, (-1, 3, 4)), shape_vu, pixel_mm)


def _is_number(value: Any) -> bool:
    return (
        isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= _LARGEST
    )


def _count(path: Path, content: dict[str, Any], key: str) -> int:
    value = content[key]
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= _MOST_PIXELS:
        raise file_error(
            path, f"{value!r} is not a count of pixels", "give a positive whole number", place=key
        )
    return value


def _numbers(path: Path, values: Any, place: str, count: int | None = None) -> list[float]:
    if not isinstance(values, list) or not all(_is_number(v) for v in values):
        raise file_error(path, "is not a list of finite numbers", "correct it there", place=place)
    if count is not None and len(values) != count:
        raise file_error(
            path, f"has {len(values)} numbers", f"a 3x4 matrix has {count}, row by row", place=place
        )
    return [float(v) for v in values]


# plain matrices
# --------------------------------------------------------------------------------------------------


def _plain_text(geometry: ConeBeamGeometry) -> str:
    lines = [
        " ".join(repr(x) for x in matrix)
        for matrix in _matrices_mm(geometry).reshape(-1, 12).tolist()
    ]
    return (
        "# a 3x4 matrix a view, row by row: world mm to (column, row) pixels\n"
        + "\n".join(lines)
        + "\n"
    )


def _load_matrices(
    path: Path, shape_vu: tuple[int, int] | None, pixel_mm: float | None, view_rate_hz: float
) -> ConeBeamGeometry:
    values = _npy_values(path) if path.suffix.lower() == ".npy" else _text_values(path)
    if values.size == 0 or values.size % 12:
        raise file_error(
            path,
            f"holds {values.size} numbers, which is no whole count of 3x4 matrices",
            "give 12 numbers a view",
        )
    if shape_vu is None:
        raise file_error(path, "does not say how large the detector is", _NEEDS_DETECTOR)
    matrices = values.reshape(-1, 3, 4)
    if not np.isfinite(matrices).all():
        view = int(np.flatnonzero(~np.isfinite(matrices).all(axis=(1, 2)))[0])
        raise file_error(
            path, "holds numbers that are not finite", "correct them there", place=f"matrix {view}"
        )
    return _geometry(path, np.arange(len(matrices)) / view_rate_hz, matrices, shape_vu, pixel_mm)


def _npy_values(path: Path) -> FloatArray:
    cure = "write it with numpy.save of a (views, 3, 4) array"
    try:
        values = np.load(path, allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise file_error(path, "is not an .npy file of numbers", cure) from error
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
        raise file_error(path, "is not an .npy file of real numbers", cure)
    if values.shape[-2:] != (3, 4) and values.shape[-1:] != (12,):
        raise file_error(path, f"holds an array of shape {values.shape}", cure)
    return values.astype(float)


def _text_values(path: Path) -> FloatArray:
    """Numbers with any of blanks, commas, semicolons and brackets between them; # starts a
    comment.
    """
    values: list[float] = []
    for number, line in enumerate(path.read_text("utf-8-sig").splitlines(), 1):
        for word in re.split(r"[\s,;\[\](){}]+", line.partition("#")[0].strip()):
            try:
                values += [float(word)] if word else []
            except ValueError as error:
                raise file_error(
                    path,
                    f"{word!r} is not a number",
                    "a file of matrices holds 12 numbers a view",
                    place=f"line {number}",
                ) from error
    return np.array(values)


# RTK XML
# --------------------------------------------------------------------------------------------------


def _rtk_matrix(parameters: dict[str, float]) -> FloatArray:
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


def _rtk_parameters(path: Path, matrix_mm: FloatArray, view: int) -> list[float]:
    """RTK's nine numbers, in the order of ``_RTK_PARAMETERS``, of a matrix (3, 4) from world mm to
    mm on the detector.
    """
    # third row of unit length and w negative in front, as RTK has it
    matrix = -matrix_mm / np.linalg.norm(matrix_mm[2, :3])
    third = matrix[2, :3]
    foot_u, foot_v = matrix[0, :3] @ third, matrix[1, :3] @ third
    row_u, row_v = matrix[0, :3] - foot_u * third, matrix[1, :3] - foot_v * third
    distance = np.linalg.norm(row_u)
    rotation = np.stack([-row_u / distance, -row_v / distance, third])
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9):
        raise file_error(
            path,
            f"view {view} has skewed or not square pixels",
            "write legsim JSON or matrices instead, RTK has no such detector",
        )
    if np.linalg.det(rotation) < 0:
        raise file_error(
            path,
            f"view {view} is mirrored (rows or columns run backwards)",
            "write legsim JSON or matrices instead, RTK has no mirror",
        )
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


def _millimeters_from_pixels(shape_vu: tuple[int, int], pixel_mm: float) -> FloatArray:
    """(3, 3) from pixel coordinates to mm on a detector whose middle is the origin."""
    rows, columns = shape_vu
    return np.array(
        [
            [pixel_mm, 0, -pixel_mm * (columns - 1) / 2],
            [0, pixel_mm, -pixel_mm * (rows - 1) / 2],
            [0, 0, 1],
        ]
    )


def _rtk_text(path: Path, geometry: ConeBeamGeometry) -> str:
    rows, columns = geometry.shape_vu
    pixel_mm = geometry.pixel_pitch * 1e3
    note = json.dumps(
        {"columns": columns, "rows": rows, "pixel_mm": pixel_mm, "times_s": geometry.times.tolist()}
    )
    lines = [
        '<?xml version="1.0"?>',
        "<!DOCTYPE RTKGEOMETRY>",
        '<RTKThreeDCircularGeometry version="3">',
        f"  <!-- legsim {note} -->",
    ]
    for view, matrix in enumerate(
        _millimeters_from_pixels(geometry.shape_vu, pixel_mm) @ _matrices_mm(geometry)
    ):
        parameters = _rtk_parameters(path, matrix, view)
        written = _rtk_matrix(dict(zip(_RTK_PARAMETERS, parameters, strict=True)))
        lines += ["  <Projection>"]
        lines += [
            f"    <{name}>{value!r}</{name}>"
            for name, value in zip(_RTK_PARAMETERS, parameters, strict=True)
        ]
        lines += [
            "    <Matrix>",
            *("      " + " ".join(repr(x) for x in row) for row in written.tolist()),
            "    </Matrix>",
        ]
        lines += ["  </Projection>"]
    return "\n".join([*lines, "</RTKThreeDCircularGeometry>", ""])


def _load_rtk(
    path: Path, shape_vu: tuple[int, int] | None, pixel_mm: float | None, view_rate_hz: float
) -> ConeBeamGeometry:
    try:
        root = ElementTree.fromstring(
            path.read_bytes(),
            ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True)),
        )
    except ElementTree.ParseError as error:
        raise file_error(path, f"is not XML ({error})", "correct it there") from error
    if root.tag != "RTKThreeDCircularGeometry" or root.get("version") != "3":
        found = f"<{root.tag} version={root.get('version')!r}>"
        raise file_error(
            path,
            f"begins with {found}",
            'only RTK\'s <RTKThreeDCircularGeometry version="3"> is known',
        )
    note = _legsim_note(path, root)
    times = None
    if note is not None and shape_vu is None and pixel_mm is None:
        shape_vu, pixel_mm, times = (
            (note["rows"], note["columns"]),
            note["pixel_mm"],
            note["times_s"],
        )
    if shape_vu is None or pixel_mm is None:
        raise file_error(
            path, "does not say how large the detector and its pixels are", _NEEDS_DETECTOR
        )
    matrices = np.array(_rtk_matrices(path, root))
    if times is None or len(times) != len(matrices):
        times = np.arange(len(matrices)) / view_rate_hz
    return _geometry(
        path,
        times,
        np.linalg.inv(_millimeters_from_pixels(shape_vu, pixel_mm)) @ matrices,
        shape_vu,
        pixel_mm,
    )


def _legsim_note(path: Path, root: ElementTree.Element) -> dict[str, Any] | None:
    """What legsim leaves in a comment, since RTK's format has no place for the detector and the
    times.
    """
    for element in root:
        text = (element.text or "").strip()
        if element.tag is ElementTree.Comment and text.startswith("legsim {"):
            try:
                note = json.loads(text.removeprefix("legsim "))
            except json.JSONDecodeError as error:
                raise file_error(
                    path,
                    f"legsim's comment is not JSON ({error.msg})",
                    "restore or remove it",
                    place="comment",
                ) from error
            if not {"rows", "columns", "pixel_mm", "times_s"} <= set(note):
                return None
            counts = {key: _count(path, note, key) for key in ("rows", "columns")}
            if not (_is_number(note["pixel_mm"]) and note["pixel_mm"] > 0):
                raise file_error(
                    path,
                    f"{note['pixel_mm']!r} is not a positive number",
                    "restore or remove legsim's comment",
                    place="pixel_mm",
                )
            return {
                **counts,
                "pixel_mm": note["pixel_mm"],
                "times_s": _numbers(path, note["times_s"], "times_s"),
            }
    return None


def _rtk_matrices(path: Path, root: ElementTree.Element) -> list[FloatArray]:
    """(3, 4) of each view. As in RTK, a parameter stays until another value is given, and starts at
    0.
    """
    parameters, given, matrices = dict.fromkeys(_RTK_PARAMETERS, 0.0), set(), []
    for element in root:
        if element.tag == "Projection":
            matrices.append(
                _rtk_view(path, element, parameters, given, f"projection {len(matrices)}")
            )
        elif isinstance(element.tag, str):
            _read_parameter(path, element, parameters, given, "before the projections")
    if not matrices:
        raise file_error(path, "holds no <Projection>", "a geometry needs one a view")
    return matrices


def _rtk_view(
    path: Path,
    element: ElementTree.Element,
    parameters: dict[str, float],
    given: set[str],
    place: str,
) -> FloatArray:
    stated = None
    for child in element:
        if child.tag == "Matrix":
            stated = _rtk_numbers(path, child, place, 12).reshape(3, 4)
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
    if not (
        parameters["SourceToIsocenterDistance"] > 0 and parameters["SourceToDetectorDistance"] > 0
    ):
        raise file_error(
            path,
            "source distances are missing or not positive",
            "give SourceToIsocenterDistance and SourceToDetectorDistance",
            place=place,
        )
    matrix = _rtk_matrix(parameters)
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
    """Takes one of the nine parameters; a curved detector is refused; collimation, which moves
    nothing, is passed over.
    """
    if element.tag in parameters:
        parameters[element.tag] = float(_rtk_numbers(path, element, place, 1)[0])
        given.add(element.tag)
    elif (
        element.tag == "RadiusCylindricalDetector" and _rtk_numbers(path, element, place, 1)[0] != 0
    ):
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
            f"known are {', '.join(_RTK_PARAMETERS)} and Matrix",
            place=place,
        )


def _rtk_numbers(path: Path, element: ElementTree.Element, place: str, count: int) -> FloatArray:
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
    if len(values) != count or not np.isfinite(values).all():
        raise file_error(
            path,
            f"<{element.tag}> holds {len(values)} numbers",
            f"expected {count}, all finite",
            place=place,
        )
    return values
