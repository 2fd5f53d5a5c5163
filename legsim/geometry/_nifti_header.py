"""Where a NIfTI file says its voxels are: by a quaternion and by a matrix."""

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from legsim.core.errors import file_error
from legsim.core.values import FloatArray
from legsim.geometry import _whole_files


def check(path: Path, header: Mapping[str, str]) -> None:
    """Refuses a NIfTI file whose two statements of where its voxels are contradict each other.

    Programs take either: what is left in one may be right in the other.

    Args:
        path: for the error.
        header: its fields as ITK names them.

    Raises:
        LegsimError: the directions or spacings of qform and sform differ.
    """
    if not {"qform_code", "sform_code", "srow_x", "quatern_b"} <= header.keys():
        return

    def numbers(*names: str) -> FloatArray:
        return np.array([[float(x) for x in header[n].split()] for n in names])

    if min(numbers("qform_code")[0, 0], numbers("sform_code")[0, 0]) <= 0:
        return
    stated = numbers("srow_x", "srow_y", "srow_z")[:, :3]
    steps = numbers("pixdim[1]", "pixdim[2]", "pixdim[3]")[:, 0]
    b, c, d = numbers("quatern_b", "quatern_c", "quatern_d")[:, 0]
    a = np.sqrt(max(0.0, 1 - b * b - c * c - d * d))
    turn = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - c * c - b * b],
        ]
    )
    if np.abs(turn * steps * [1, 1, _sense(path)] - stated).max() > 0.02 * steps.max():
        raise file_error(
            path,
            "its qform and its sform place the voxels differently",
            "keep the one that is right (as ITK-SNAP or nibabel write it), or save it as .nrrd",
        )


def _sense(path: Path) -> float:
    """-1 where the third axis of the quaternion is turned about, else 1: pixdim[0], which ITK does
    not report.
    """
    with _whole_files.opened(path) as stream:
        head = stream.read(112)
    order, second = _whole_files.nifti_layout(head)
    # pixdim[0]: a float at byte 76 of NIfTI-1, a double at byte 104 of NIfTI-2
    sense = struct.unpack_from(f"{order}{'d' if second else 'f'}", head, 104 if second else 76)[0]
    return -1.0 if sense < 0 else 1.0
