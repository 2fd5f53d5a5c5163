"""Whether an image file is whole: several of ITK's readers take what is missing for anything."""

import errno
import gzip
import math
import os
import re
import struct
import zlib
from pathlib import Path
from typing import BinaryIO

from legsim.core import files
from legsim.core.errors import file_error

_TRUSTING = (".nii", ".hdr", ".img", ".gipl", ".mrc", ".rec", ".vtk")
"""Endings (also with .gz) whose readers take what is missing for anything"""

_NIFTI_BYTES = 544
"""that hold the header of either version of NIfTI"""

_BEFORE = {".gipl": 256, ".mrc": 1024, ".rec": 1024}
"""bytes of header, at least"""


def check(path: Path, values: int) -> None:
    """Refuses a file that breaks off, given how many bytes its values take.

    A compressed file is read to its end, where its checksum is.

    Raises:
        LegsimError: values are missing, or the compressed content is damaged.
    """
    name = path.name.lower().removesuffix(".gz")
    if not name.endswith(_TRUSTING) or _is_text(path):
        return
    data = _of_values(path)
    try:
        with opened(data) as stream:
            if name.endswith(".nii"):
                needed = _nifti_needs(stream.read(_NIFTI_BYTES))
            else:
                needed = values + _BEFORE.get(Path(name).suffix, 0)
            there = stream.seek(0, os.SEEK_END)
    except (EOFError, OSError, OverflowError, ValueError, zlib.error, struct.error) as error:
        problem = f"cannot be read to its end ({error})"
        raise file_error(data, problem, "write or copy it again") from error
    if there < needed:
        raise file_error(
            data,
            f"has {there} bytes, but its values and header take {needed}",
            "write or copy it again, uncompressed",
        )


def _of_values(path: Path) -> Path:
    """The file with the values: a header (.hdr) has them in another beside it."""
    stem = re.sub(r"\.hdr(\.gz)?$", "", path.name.lower())
    wanted = (f"{stem}.img", f"{stem}.img.gz")
    if stem == path.name.lower():
        return path
    return next((p for p in sorted(path.parent.iterdir()) if p.name.lower() in wanted), path)


def _is_text(path: Path) -> bool:
    """Whether a file of VTK holds its values as text, of any length."""
    if path.suffix.lower() != ".vtk":
        return False
    with path.open("rb") as stream:
        return b"\nASCII" in stream.read(512)


def refuse_other_kinds(path: Path) -> None:
    """Refuses, by its kind, a file that ITK did not read: FreeSurfer's, packed ones (but for NIfTI,
    which ITK unpacks) and NIfTI-2.

    Raises:
        LegsimError: says the kind, and what to do.
    """
    name = path.name.lower()
    if name.endswith((".mgz", ".mgh")):
        raise file_error(path, "is FreeSurfer's", "write it as .nii.gz (mri_convert does)")
    unpacked_by_itk = name.endswith((".nii.gz", ".hdr.gz", ".img.gz"))
    if not (unpacked_by_itk and files.beginning(path, 2) == b"\x1f\x8b"):
        files.refuse_packed(path)
    if name.removesuffix(".gz").endswith((".nii", ".hdr")):
        try:
            with opened(path) as stream:
                second = nifti_layout(stream.read(4))[1]
        except (EOFError, OSError, zlib.error, struct.error):
            return
        if second:
            cure = "write it as NIfTI-1 (nibabel's Nifti1Image) or .nrrd"
            raise file_error(path, "is NIfTI-2, which ITK does not read", cure)


def opened(path: Path) -> gzip.GzipFile | BinaryIO:
    """The uncompressed content of a file, whatever its name says."""
    with path.open("rb") as stream:
        compressed = stream.read(2) == b"\x1f\x8b"
    return gzip.open(path) if compressed else path.open("rb")


def nifti_layout(head: bytes) -> tuple[str, bool]:
    """(order of bytes, whether it is NIfTI-2) of a header."""
    order = "<" if struct.unpack_from("<i", head)[0] in (348, 540) else ">"
    return order, struct.unpack_from(f"{order}i", head)[0] == 540


def _nifti_needs(head: bytes) -> int:
    """Bytes of a NIfTI file's header and values."""
    order, second = nifti_layout(head)
    # dim, bitpix and vox_offset of NIfTI-2 and NIfTI-1
    dim, bits, offset = ("8q", 16), ("h", 14), ("q", 168)
    if not second:
        dim, bits, offset = ("8h", 40), ("h", 72), ("f", 108)
    sizes = struct.unpack_from(order + dim[0], head, dim[1])
    count = math.prod(max(1, size) for size in sizes[1 : 1 + max(0, sizes[0])])
    bytes_each = struct.unpack_from(order + bits[0], head, bits[1])[0] / 8
    first = struct.unpack_from(order + offset[0], head, offset[1])[0]
    return int(max(first, 544 if second else 352) + count * bytes_each)


_BEFORE_VALUES = {".mha": b"ElementDataFile = LOCAL\n", ".nrrd": b"\n\n"}
"""how the header ends; NIfTI's has a fixed size"""

_NIFTI_HEADER = 352
"""bytes"""


def check_written(path: Path, ending: str, values: int) -> None:
    """Checks that all bytes were written: writers of NIfTI and NRRD do not notice a full disk.

    Raises:
        OSError: some are missing.
    """
    end = _BEFORE_VALUES.get(ending)
    with gzip.open(path) if ending == ".nii.gz" else path.open("rb") as stream:
        try:
            start = stream.read(4096).find(end) + len(end) if end else _NIFTI_HEADER
            there = stream.seek(0, os.SEEK_END)
        except EOFError:  # a compressed file without its end
            start, there = 0, 0
    if there < max(start, 1) + values:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
