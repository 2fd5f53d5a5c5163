"""DICOM: views of a scan, by pydicom where it is installed (`pip install legsim[dicom]`)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from legsim.core.errors import LegsimError, file_error
from legsim.core.files import beginning
from legsim.core.values import FloatArray, within

if TYPE_CHECKING:
    from pydicom.dataset import Dataset  # pyright: ignore[reportMissingImports]  # an extra

_TOMOGRAPHS = ("CT", "MR", "PT", "NM")

_SLICES = tuple(
    f"1.2.840.10008.5.1.4.1.1.{kind}"
    for kind in (
        "2",
        "2.1",
        "2.2",
        "4",
        "4.1",
        "4.3",
        "4.4",
        "13.1.1",
        "13.1.2",
        "128",
        "128.1",
        "130",
    )
)
"""classes of images in a patient: CT, MR (usual, enhanced, converted), X-ray 3D, PET"""


@dataclass(frozen=True, slots=True, eq=False)
class DicomViews:
    """Views of one file."""

    values: NDArray
    """(v, rows, columns); whole numbers unless the file rescales them"""
    pixel_mm: tuple[float, float] | None
    """(between columns, between rows) on the detector"""
    angles_deg: FloatArray | None
    """(v,) of the positioner about the patient"""
    no_counts: str = ""
    """what the file says against its values being proportional to intensity; empty: nothing"""
    notes: tuple[str, ...] = ()
    detector_mm: float | None = None
    """from the source to the detector"""


def is_dicom(path: Path) -> bool:
    """Whether a file has DICOM's mark after its preamble.

    Raises:
        LegsimError: it cannot be read.
    """
    return beginning(path, 132)[128:] == b"DICM"


def is_image(path: Path) -> bool:
    """Whether a file is DICOM's, and not the directory (DICOMDIR) of others."""
    return path.is_file() and path.name.upper() != "DICOMDIR" and is_dicom(path)


def refuse_as_volume(path: Path) -> None:
    """Refuses a DICOM file where one file holds a volume: ITK stacks the frames of segmentations
    and enhanced images without asking where they lie.
    """
    if is_dicom(path):
        raise file_error(
            path,
            "is one DICOM file, which is not read as a volume",
            "give the folder of a series of CT slices; write a segmentation as NRRD or NIfTI",
        )


def read_projections(path: Path) -> DicomViews:
    """Reads the frames of a file, rescaled where it says so, with their angles.

    Raises:
        LegsimError: pydicom is missing, or a file without gray images that can be decoded.
    """
    pydicom = require_pydicom(path)
    if not is_dicom(path):
        raise file_error(
            path,
            "has no preamble of DICOM files",
            "write it as one (dcmconv of DCMTK does), or export it again",
        )
    try:
        data = pydicom.dcmread(path)
        values = np.asarray(data.pixel_array)
    except Exception as error:
        # pydicom raises many kinds of errors on broken files and unknown compressions
        line = (str(error).strip().splitlines() or [type(error).__name__])[0]
        cure = "export it without compression"
        if "no pixel data" in line.lower() or "no 'Pixel Data'" in line:
            cure = "give the files of the images: this one is a report, a plan or the like"
        raise file_error(path, f"holds no image that can be read ({line})", cure) from error
    try:
        _check_plain(path, data)
        return _views(data, values[None] if values.ndim == 2 else values)
    except (TypeError, ValueError, AttributeError, OverflowError, NotImplementedError) as error:
        # a damaged element raises when it is looked at
        problem = f"its rescaling, pixel size or angles are no numbers ({error})"
        raise file_error(path, problem, "correct them, or export it again") from error


def _check_plain(path: Path, data: "Dataset") -> None:
    """Refuses colors, slices of a patient, tables of values and shifted bits."""
    if int(data.get("SamplesPerPixel", 1)) != 1:
        raise file_error(path, "holds colors", "export gray images")
    if _lies_in_patient(data):
        kind = data.get("Modality") or "no modality"
        problem = f"is a slice that lies in the patient ({kind}), no projection of one"
        raise file_error(path, problem, "give the views of the scan, before reconstruction")
    if data.get("ModalityLUTSequence"):
        raise file_error(
            path, "maps its values by a table (Modality LUT)", "export the values themselves"
        )
    high, stored = data.get("HighBit"), data.get("BitsStored")
    if high is not None and stored is not None and high + 1 != stored:
        problem = f"holds {stored} bits up to bit {high}, shifted ones"
        raise file_error(path, problem, "export it again")


def _lies_in_patient(data: "Dataset") -> bool:
    """Whether frames have a place in the patient, by themselves or in groups.

    Some programs place captured views at 0: that alone says nothing, but of a tomograph.
    """
    places = [data.get("ImagePositionPatient") if data.get("ImageOrientationPatient") else None]
    places += _of_frames(data, "PlanePositionSequence", "ImagePositionPatient")
    stated = [[float(x) for x in place] for place in places if place]
    tomograph = data.get("Modality") in _TOMOGRAPHS or data.get("SOPClassUID") in _SLICES
    return any(tomograph or any(place) for place in stated)


def _views(data: "Dataset", values: NDArray) -> DicomViews:
    """The frames (v, rows, columns) with what the elements say of them."""
    rescaling = _rescaling(data, len(values))
    notes: tuple[str, ...] = ()
    if (rescaling != (1.0, 0.0)).any():
        slopes, intercepts = rescaling.T
        values = values * slopes[:, None, None] + intercepts[:, None, None]
        notes = (f"values rescaled as the file says: {_in_words(rescaling)}",)
    angles, how = _angles(data, len(values))
    pixel, of_plane = _plane_pixel_mm(data) if data.get("Modality") == "RTIMAGE" else (None, ())
    return DicomViews(
        values,
        _pixel_mm(data) or pixel,
        angles,
        _against_counts(data),
        (*notes, *how, *of_plane),
        _detector_mm(data),
    )


def _rescaling(data: "Dataset", views: int) -> FloatArray:
    """(v, 2) slope and intercept of each frame, as the file, or its groups of all frames or of
    each, state them.
    """

    def stated(group: "Dataset", otherwise: "Dataset") -> "Dataset":
        found = group.get("PixelValueTransformationSequence")
        return found[0] if found else otherwise

    common = data
    for group in data.get("SharedFunctionalGroupsSequence") or ():
        common = stated(group, common)
    each = [stated(g, common) for g in data.get("PerFrameFunctionalGroupsSequence") or ()]
    each = each or [common] * views
    numbers = np.array(
        [[_number(one, "RescaleSlope", 1), _number(one, "RescaleIntercept", 0)] for one in each]
    )
    if len(numbers) != views or not within(numbers) or not numbers[:, 0].all():
        raise ValueError(f"{len(numbers)} frames rescaled by {_in_words(numbers)}")
    return numbers


def _of_frames(data: "Dataset", sequence: str, name: str) -> list[Any]:
    """Values of an element of enhanced images, which keep those of frames in groups.

    They are one per frame, or one for all frames together; frames without it are left out.
    """
    groups = [
        *(data.get("SharedFunctionalGroupsSequence") or ()),
        *(data.get("PerFrameFunctionalGroupsSequence") or ()),
    ]
    inner = [found[0] for group in groups if (found := group.get(sequence))]
    return [one.get(name) for one in inner if one.get(name) is not None]


def _number(group: "Dataset", name: str, otherwise: float) -> float:
    """Number of an element; ``otherwise`` where it is missing or empty."""
    found = group.get(name)
    return otherwise if found is None else float(found)


def _in_words(rescaling: FloatArray) -> str:
    """Slopes and intercepts (v, 2), or their ranges."""
    ends = zip(rescaling.min(0), rescaling.max(0), strict=True)
    slope, intercept = (f"{a:g}" if a == b else f"{a:g} to {b:g}" for a, b in ends)
    return f"times {slope} plus {intercept}"


def _against_counts(data: "Dataset") -> str:
    """What PixelIntensityRelationship and its sign say against counts."""
    relation = str(data.get("PixelIntensityRelationship") or "LIN")
    if relation != "LIN":
        return f"values are not linear in intensity (PixelIntensityRelationship {relation})"
    if data.get("PixelIntensityRelationshipSign") == -1:
        return "values fall where intensity rises (PixelIntensityRelationshipSign -1)"
    return ""


def in_order(paths: list[Path]) -> list[Path]:
    """Files of one series by their instance numbers; names of DICOM files often say nothing.

    Raises:
        LegsimError: pydicom is missing, several series, a file without number, or one number twice.
    """
    pydicom = require_pydicom(paths[0])
    numbered: dict[int, Path] = {}
    series = set()
    for path in paths:
        try:
            data = pydicom.dcmread(path, stop_before_pixels=True)
            number = int(data.InstanceNumber)
            series.add(str(data.get("SeriesInstanceUID", "")))
        except Exception as error:
            # pydicom raises many kinds of errors on broken files
            raise file_error(
                path, "has no instance number that can be read", "leave it out, or number it"
            ) from error
        if number in numbered:
            raise file_error(
                path,
                f"has the same instance number, {number}, as {numbered[number].name}",
                "give the files of one series alone",
            )
        numbered[number] = path
    if len(series) > 1:
        raise file_error(
            paths[0].parent, f"holds {len(series)} series", "give a folder with one of them"
        )
    return [numbered[number] for number in sorted(numbered)]


def require_pydicom(path: Path):
    """The module.

    Raises:
        LegsimError: it is not installed.
    """
    try:
        import pydicom  # pyright: ignore[reportMissingImports]  # an extra
    except ModuleNotFoundError as error:
        raise LegsimError(
            f"{path}: DICOM needs pydicom, which is not installed; pip install 'legsim[dicom]'"
        ) from error
    return pydicom


def _pixel_mm(data: "Dataset") -> tuple[float, float] | None:
    """(between columns, between rows): the detector's; DICOM states rows first."""
    grouped = _of_frames(data, "FramePixelDataPropertiesSequence", "ImagerPixelSpacing")
    stated = data.get("ImagerPixelSpacing") or next(iter(grouped), None)
    if stated is None:
        return None
    if any(list(one) != list(stated) for one in grouped):
        raise ValueError("frames with pixels of several sizes")
    return _columns_first(stated)


def _detector_mm(data: "Dataset") -> float | None:
    """From the source to the detector, where all frames state one distance."""
    stated = _of_frames(data, "XRayGeometrySequence", "DistanceSourceToDetector")
    alone = data.get("DistanceSourceToDetector")
    distances = {float(one) for one in [*stated, alone] if one not in (None, "")}
    return distances.pop() if len(distances) == 1 and min(distances) > 0 else None


def _plane_pixel_mm(data: "Dataset") -> tuple[tuple[float, float] | None, tuple[str, ...]]:
    """(pixel of an RT Image between columns and between rows, notes).

    It is that in the image plane, which some machines put through the isocenter: then the
    detector's is not known.
    """
    stated = data.get("ImagePlanePixelSpacing")
    if not stated:
        return None, ()
    pixel, plane = _columns_first(stated), data.get("RTImageSID")
    said = f"RT Image: pixels of {pixel[0]:.6g} x {pixel[1]:.6g} mm"
    if plane is None:
        return None, (f"{said} in a plane whose distance is not stated: not used",)
    center = data.get("RadiationMachineSAD")
    if center is not None and abs(float(plane) - float(center)) < 1.0:
        return None, (f"{said} in the plane of the isocenter, not on the detector: not used",)
    return pixel, (f"{said} on the detector, {float(plane):.6g} mm from the source",)


def _columns_first(stated: Sequence[float]) -> tuple[float, float]:
    """A pixel's size in mm that DICOM states between rows first."""
    pixel = (float(stated[1]), float(stated[0]))
    if not (within(np.array(pixel)) and min(pixel) > 0):
        raise ValueError(f"pixels of {pixel[0]:g} x {pixel[1]:g} mm")
    return pixel


def _angles(data: "Dataset", views: int) -> tuple[FloatArray | None, tuple[str, ...]]:
    """((v,) positioner's primary angles in degrees, notes).

    The increments of a moving positioner are counted from the first frame by some programs and
    from the frame before by others: equal ones are steps.
    """
    # an empty element is there, with None
    stated = (data.get(name) for name in ("PositionerPrimaryAngle", "GantryAngle"))
    start = next((angle for angle in stated if angle not in (None, "")), None)
    if start is None:
        angles = _of_frames(data, "PositionerPositionSequence", "PositionerPrimaryAngle")
        return (np.array(angles, float), ()) if len(angles) == views else (None, ())
    stated = data.get("PositionerPrimaryAngleIncrement")
    if stated is None:
        return (np.array([float(start)]), ()) if views == 1 else (None, ())
    increments = np.atleast_1d(np.asarray(stated, float))
    if len(increments) != views:
        return None, (f"{len(increments)} angle increments for {views} frames are not used",)
    steps = views > 2 and np.ptp(increments[1:]) < 0.5 * abs(increments[1:].mean())
    angles = float(start) + (np.cumsum(increments) if steps else increments)
    counted = "from frame to frame" if steps else "from the first frame"
    note = f"angles from {angles[0]:.1f} to {angles[-1]:.1f} deg (increments {counted})"
    return angles, (note,)
