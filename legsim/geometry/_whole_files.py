"""Whether an image file is whole: several of ITK's readers take what is missing for anything."""

import gzip
import math
import os
import struct
import zlib
from pathlib import Path
from typing import BinaryIO

from legsim.core.errors import file_error

_NOTICED = (".mha", ".mhd", ".nrrd", ".nhdr", ".png", ".tif", ".tiff", ".h5", ".hdf5")
"""Endings whose readers notice themselves that values are missing"""

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
    name = path.name.lower()
    if name.endswith(_NOTICED):
        return
    data = path.with_suffix(".img") if name.endswith(".hdr") else path
    try:
        with opened(data) as stream:
            if name.endswith((".nii", ".nii.gz")):
                needed = _nifti_needs(stream.read(_NIFTI_BYTES))
            else:
                needed = values + _BEFORE.get(Path(name.removesuffix(".gz")).suffix, 0)
            there = stream.seek(0, os.SEEK_END)
    except (EOFError, OSError, zlib.error, struct.error) as error:
        problem = f"cannot be read to its end ({error})"
        raise file_error(data, problem, "write or copy it again") from error
    if there < needed:
        raise file_error(
            data,
            f"has {there} bytes, but its values and header take {needed}",
            "write or copy it again, uncompressed",
        )


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
