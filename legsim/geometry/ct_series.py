"""Volumes as a DICOM CT series: axial slices in Hounsfield units, without a patient.

HU = 1000 (mu / mu_water - 1). Slices lie across world's y, the body's axis, the lowest first;
columns run to the patient's left, rows to posterior. Identifiers follow from the content, so that
the same volume gives the same series. Needs pydicom (`pip install legsim[dicom]`).
"""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from legsim import __version__
from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.geometry.dicom import require_pydicom
from legsim.geometry.image_files import LPS_FROM_WORLD
from legsim.geometry.volume import Volume

_LARGEST = 32767
"""of a stored number: 16 bits with a sign"""


def save(
    folder: Path | str, volume: Volume, *, water: float, description: str = "legsim"
) -> list[Path]:
    """Writes one file per slice into a folder, which is made where it is missing.

    Args:
        folder: without other DICOM files.
        volume: attenuation in 1/m.
        water: attenuation of water in 1/m at the energy of the volume.
        description: of the series; no name of a person.

    Raises:
        LegsimError: pydicom is missing, water is not positive, values that are not finite, a folder
            with DICOM files in it, or a file that cannot be written.
    """
    folder = Path(folder)
    require_pydicom(folder)
    if not (np.isfinite(water) and water > 0):
        raise LegsimError(f"water's attenuation is {water:g}/m; it must be positive")
    if not np.isfinite(volume.attenuation).all():
        raise file_error(folder, "the volume holds values that are not finite", "replace them")
    if folder.is_dir() and any(folder.glob("*.dcm")):
        raise file_error(
            folder, "holds DICOM files already", "name a new folder, series must not mix"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise file_error(
            folder, f"cannot be made ({error.strerror})", "name another folder"
        ) from error
    count = volume.grid.shape_zyx[1]
    slope = _slope(volume, water)
    series = _series(volume, water, slope, description)
    paths = []
    for k in range(count):
        path = folder / f"slice_{k:0{max(4, len(str(count)))}}.dcm"
        data = _slice(volume, k, water, slope, series)
        with files.whole(path) as partial:
            data.save_as(partial, enforce_file_format=True)
        paths.append(path)
    return paths


def hounsfield(attenuation: NDArray, water: float) -> FloatArray:
    """HU of attenuation, both in the same unit."""
    return 1000.0 * (np.asarray(attenuation, float) / water - 1.0)


def _slope(volume: Volume, water: float) -> float:
    """HU per stored number: 1, or more where the volume's range asks for it."""
    ends = [volume.attenuation.min(), volume.attenuation.max()]
    most = float(np.abs(hounsfield(np.array(ends), water)).max())
    return 1.0 if most <= _LARGEST else float(f"{1.0001 * most / _LARGEST:.6g}")


def _series(volume: Volume, water: float, slope: float, description: str) -> dict[str, Any]:
    """Elements that all slices share."""
    from pydicom.uid import generate_uid  # pyright: ignore[reportMissingImports]  # an extra

    digest = hashlib.sha256(np.ascontiguousarray(volume.attenuation).tobytes()).hexdigest()
    about = f"{digest} {volume.grid!r} {water!r} {description}"
    nz, _, nx = volume.grid.shape_zyx
    dx, dy, dz = (1e3 * s for s in volume.grid.spacing_xyz)
    return {
        "StudyInstanceUID": generate_uid(entropy_srcs=[about, "study"]),
        "SeriesInstanceUID": generate_uid(entropy_srcs=[about, "series"]),
        "FrameOfReferenceUID": generate_uid(entropy_srcs=["legsim", "world"]),
        **dict.fromkeys(("PatientName", "PatientBirthDate", "PatientSex"), ""),
        "PatientID": "legsim",
        "PatientIdentityRemoved": "YES",
        "DeidentificationMethod": "Computed volume, never held a patient's data",
        **dict.fromkeys(("StudyDate", "StudyTime", "AccessionNumber"), ""),
        **dict.fromkeys(("ReferringPhysicianName", "StudyID", "PositionReferenceIndicator"), ""),
        "Laterality": "",
        "SeriesNumber": 1,
        "AcquisitionNumber": None,
        "KVP": None,
        "SeriesDescription": description[:64],
        "Modality": "CT",
        "PatientPosition": "HFS",
        "Manufacturer": "legsim",
        "SoftwareVersions": __version__,
        "ImageType": ["DERIVED", "SECONDARY", "AXIAL"],
        "DerivationDescription": f"HU with water at {1e-3 * water:.6g}/mm",
        "SamplesPerPixel": 1,
        "PhotometricInterpretation": "MONOCHROME2",
        "Rows": nx,
        "Columns": nz,
        "PixelSpacing": [_text(dx), _text(dz)],
        "SliceThickness": _text(dy),
        "SpacingBetweenSlices": _text(dy),
        "ImageOrientationPatient": [1, 0, 0, 0, 1, 0],
        "BitsAllocated": 16,
        "BitsStored": 16,
        "HighBit": 15,
        "PixelRepresentation": 1,
        "RescaleIntercept": "0",
        "RescaleSlope": _text(slope),
        "RescaleType": "HU",
    }


def _slice(volume: Volume, k: int, water: float, slope: float, series: dict[str, Any]) -> Any:
    """The data set of slice ``k`` from below: rows to posterior (-x), columns to left (-z)."""
    from pydicom.dataset import (  # pyright: ignore[reportMissingImports]  # an extra
        FileDataset,
        FileMetaDataset,
    )
    from pydicom.uid import (  # pyright: ignore[reportMissingImports]  # an extra
        CTImageStorage,
        ExplicitVRLittleEndian,
        generate_uid,
    )

    values = hounsfield(volume.attenuation[::-1, k, ::-1].T, water)
    x, y, z = volume.grid.axes()
    first = 1e3 * LPS_FROM_WORLD @ np.array([x[-1], y[k], z[-1]])
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = CTImageStorage
    meta.MediaStorageSOPInstanceUID = generate_uid(
        entropy_srcs=[series["SeriesInstanceUID"], str(k)]
    )
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data = FileDataset("", {}, preamble=b"\0" * 128, file_meta=meta)
    data.SOPClassUID, data.SOPInstanceUID = CTImageStorage, meta.MediaStorageSOPInstanceUID
    for name, value in series.items():
        setattr(data, name, value)
    data.InstanceNumber = k + 1
    data.ImagePositionPatient = [_text(p) for p in first]
    data.SliceLocation = _text(1e3 * float(y[k]))
    data.PixelData = np.rint(values / slope).astype("<i2").tobytes()
    return data


def _text(number: float) -> str:
    """A number in the 16 characters that DICOM's decimal strings have."""
    number = float(number) + 0.0  # no -0
    return next(text for digits in range(17, 0, -1) if len(text := f"{number:.{digits}g}") <= 16)
