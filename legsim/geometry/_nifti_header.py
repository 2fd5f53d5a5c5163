"""Where a NIfTI file says its voxels are: by a quaternion and by a matrix."""

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from legsim.core.errors import file_error
from legsim.core.values import FloatArray
from legsim.geometry import _whole_files

_KEEP_ONE = "keep the one that is right (as ITK-SNAP or nibabel write it), or save it as .nrrd"

_SHIFTED = 0.5
"""of a voxel's longest side, from which on two places differ"""

_LONGEST = 540
"""bytes of a header, of NIfTI-2"""


def check(path: Path, header: Mapping[str, str]) -> None:
    """Refuses a NIfTI file whose statements of where its voxels are contradict each other, or hold
    a number that is not finite, or whose matrix has another spacing than the file states.

    Programs take either statement: what is left in one may be right in the other. ITK reads an
    offset that is not finite as 0.

    Args:
        path: for the error.
        header: its fields as ITK names them.

    Raises:
        LegsimError: the directions, spacings or origins of qform and sform differ; the spacing of
            sform alone differs from pixdim as ITK takes it; a place is not finite.
    """
    if not {"qform_code", "sform_code", "srow_x", "quatern_b"} <= header.keys():
        return

    def numbers(*names: str) -> FloatArray:
        return np.array([[float(x) for x in header[n].split()] for n in names])

    by_quaternion, by_matrix = (numbers(f"{form}_code")[0, 0] > 0 for form in ("qform", "sform"))
    steps_read, quaternion_read, matrix_read = _places(path)
    used = [steps_read, quaternion_read] if by_quaternion else []
    used += [matrix_read] if by_matrix else []
    if not all(np.isfinite(numbers_read).all() for numbers_read in used):
        problem = "says by a number that is not finite where its voxels are"
        raise file_error(path, problem, "write the file again")
    if by_matrix and not by_quaternion:
        _check_spacing(
            path, np.linalg.norm(matrix_read.reshape(3, 4)[:, :3], axis=0), steps_read[1:]
        )
    if not (by_quaternion and by_matrix):
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
            _KEEP_ONE,
        )
    apart = np.linalg.norm(quaternion_read[3:] - matrix_read[3::4])
    if apart > _SHIFTED * steps.max():
        problem = f"its qform and its sform place the voxels {apart:.3g} mm apart"
        raise file_error(path, problem, _KEEP_ONE)


def _check_spacing(path: Path, by_matrix: FloatArray, steps: FloatArray) -> None:
    """Refuses a matrix with another spacing than pixdim: NIfTI takes the matrix's, ITK pixdim's.

    ITK takes 0 for 1, and turns the axis of a negative one about, which the matrix does not say.
    """
    if np.abs(by_matrix - np.where(steps == 0, 1.0, steps)).max() > 0.02 * by_matrix.max():
        said, other = (", ".join(f"{s:.4g}" for s in sizes) for sizes in (steps, by_matrix))
        problem = f"states voxels of {said} by pixdim, and of {other} by its sform"
        cure = "write the sform's into pixdim if that is right (nibabel does), or save it as .nrrd"
        raise file_error(path, problem, cure)


def _sense(path: Path) -> float:
    """-1 where the third axis of the quaternion is turned about, else 1: pixdim[0], which ITK does
    not report.
    """
    return -1.0 if _places(path)[0][0] < 0 else 1.0


def _places(path: Path) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(pixdim[0] to [3]; quatern_b to d and qoffset_x to z; srow_x to z) as the file has them."""
    try:
        with _whole_files.opened(path) as stream:
            head = stream.read(_LONGEST)
    except (EOFError, OSError, zlib.error) as error:
        raise file_error(path, f"cannot be unpacked ({error})", "write the file again") from error
    order, second = _whole_files.nifti_layout(head)
    # floats in NIfTI-1, doubles in NIfTI-2
    kind, starts = ("d", (104, 352, 400)) if second else ("f", (76, 256, 280))
    steps, quaternion, matrix = (
        np.array(struct.unpack_from(f"{order}{count}{kind}", head, start))
        for start, count in zip(starts, (4, 6, 12), strict=True)
    )
    return steps, quaternion, matrix
