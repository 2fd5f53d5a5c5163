"""CONRAD's XML: a Java bean, a configuration or a trajectory, with a 3x4 matrix per view.

Java's XMLEncoder writes a matrix as the property PMatrixSerialization of a Projection, "[[a b c d];
[e f g h]; [i j k l]]", from world mm to pixels, and the detector as the properties detectorWidth,
detectorHeight, pixelDimensionX and pixelDimensionY of the trajectory. A configuration's detector
and source have properties of the same names, which may be those of another scan.
"""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from legsim.core.errors import file_error
from legsim.core.values import LARGEST, FloatArray, within
from legsim.geometry._file_parts import Given, geometry_of, matrices_mm
from legsim.geometry.cone_beam import ConeBeamGeometry

_PROJECTION = "edu.stanford.rsl.conrad.geometry.Projection"
_TRAJECTORY = "edu.stanford.rsl.conrad.geometry.trajectories.Trajectory"


def load(path: Path, root: ElementTree.Element, given: Given) -> ConeBeamGeometry:
    """The geometry of a parsed file.

    Raises:
        LegsimError: no matrices, more than one list of them, a view without its matrix, or a
            detector that is neither there nor given.
    """
    matrices = _matrices(path, root)
    trajectory = root.find(".//void[@property='projectionMatrices']/..")
    sizes = {
        name: _stated(root if trajectory is None else trajectory, name)
        for name in ("detectorWidth", "detectorHeight", "pixelDimensionX", "pixelDimensionY")
    }
    columns, rows, wide, high = sizes.values()
    shape_vu = given.shape(path, (int(rows), int(columns)) if rows and columns else None)
    pixel_mm = given.pixel(path, (wide, high) if wide and high else None)
    return geometry_of(
        path,
        given.times(len(matrices)),
        matrices,
        shape_vu,
        None if pixel_mm is None else pixel_mm[0],
    )


def text_of(geometry: ConeBeamGeometry) -> str:
    """A trajectory of CONRAD with the geometry's matrices and detector; it has no times."""
    rows, columns = geometry.shape_vu
    numbers = {
        "detectorHeight": ("int", rows),
        "detectorWidth": ("int", columns),
        "numProjectionMatrices": ("int", len(geometry)),
        "pixelDimensionX": ("double", 1e3 * geometry.pixel_pitch),
        "pixelDimensionY": ("double", 1e3 * geometry.row_pitch()),
        "projectionStackSize": ("int", len(geometry)),
        "sourceToDetectorDistance": (
            "double",
            float(1e3 * geometry.pixel_pitch * geometry.focal_lengths().mean()),
        ),
    }
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<java version="1.8.0" class="java.beans.XMLDecoder">',
        f' <object class="{_TRAJECTORY}">',
        *(
            f'  <void property="{name}"><{kind}>{value!r}</{kind}></void>'
            for name, (kind, value) in numbers.items()
        ),
        '  <void property="projectionMatrices">',
        f'   <array class="{_PROJECTION}" length="{len(geometry)}">',
    ]
    for view, matrix in enumerate(matrices_mm(geometry).tolist()):
        rows_text = "; ".join(f"[{' '.join(map(repr, row))}]" for row in matrix)
        lines += [
            f'    <void index="{view}"><object class="{_PROJECTION}">',
            f'     <void property="PMatrixSerialization"><string>[{rows_text}]</string></void>',
            "    </object></void>",
        ]
    return "\n".join([*lines, "   </array>", "  </void>", " </object>", "</java>", ""])


def _stated(root: ElementTree.Element, name: str) -> float | None:
    """The number of a bean's property, where the file has it and it is positive."""
    element = root.find(f".//void[@property='{name}']/*")
    try:
        value = float((element.text or "") if element is not None else "")
    except ValueError:
        return None
    return value if 0 < value <= LARGEST else None


def _matrices(path: Path, root: ElementTree.Element) -> FloatArray:
    """(v, 3, 4) of the only list of projections."""
    arrays = [
        array
        for array in root.iter("array")
        if array.get("class") == _PROJECTION and array.find("void") is not None
    ]
    if len(arrays) != 1:
        raise file_error(
            path,
            f"holds {len(arrays)} lists of projection matrices (array of {_PROJECTION})",
            "give a configuration or trajectory of CONRAD with exactly one",
        )
    found = {}
    for element in arrays[0].findall("void"):
        text = element.findtext(".//void[@property='PMatrixSerialization']/string", "")
        found[element.get("index", "")] = _matrix(path, text, f"projection {element.get('index')}")
    count = arrays[0].get("length", str(len(found)))
    absent = next(k for k in range(len(found) + 1) if str(k) not in found)
    if count != str(len(found)) or absent < len(found):
        place = f"projection {absent}"
        raise file_error(
            path,
            f"{count} matrices are announced, {len(found)} are there",
            "write the file again",
            place=place,
        )
    return np.array([found[str(k)] for k in range(len(found))])


def _matrix(path: Path, text: str, place: str) -> FloatArray:
    rows = [
        [word for word in re.split(r"[\s,]+", row) if word]
        for row in re.split(r"[;\[\]]", text)
        if row.strip(" ,\t\r\n")
    ]
    try:
        values = np.array(rows, float)
    except ValueError:
        values = np.empty(0)
    if values.shape != (3, 4) or not within(values):
        raise file_error(
            path,
            f"{' '.join(text.split())[:60]!r} is no matrix of 3 rows and 4 columns",
            "expected [[a b c d]; [e f g h]; [i j k l]]",
            place=place,
        )
    return values
