"""Motions as .npz files."""

import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from legsim.core.errors import LegsimError, file_error
from legsim.core.files import save_npz
from legsim.deformation.models import ControlPointMotion, FieldMotion, Motion, RigidMotion
from legsim.deformation.polyrigid import PolyrigidMotion
from legsim.geometry.volume import VolumeGrid


def save_motion(path: Path, motion: Motion) -> None:
    """Writes an .npz of the times and of what :meth:`Motion.arrays` names."""
    save_npz(path, times=motion.times, **motion.arrays())


_UNREADABLE = (
    *(OSError, EOFError, KeyError, ValueError, TypeError, zipfile.BadZipFile, zlib.error),
    RuntimeError,
)
"""what damaged archives raise; RuntimeError where one looks encrypted or otherwise packed"""


def load_motion(path: Path) -> Motion:
    """Reads what :func:`save_motion` wrote; the file's arrays say which kind of motion it is.

    Raises:
        LegsimError: not such a file.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            return _motion(_arrays(data))
    except FileNotFoundError:
        raise file_error(path, "no such file", "give a motion-<method>.npz") from None
    except _UNREADABLE as error:
        raise file_error(
            path,
            f"is not a motion file ({error})",
            "expected an .npz with times (v,) and moved_from_reference (v, 4, 4)",
        ) from None
    except LegsimError as error:
        raise file_error(path, str(error), "correct the file") from None


def _arrays(data: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What an archive holds; NumPy gives the bytes of what does not begin as an array does.

    Raises:
        ValueError: it holds something else.
    """
    arrays = {name: data[name] for name in data}
    others = [name for name, held in arrays.items() if not isinstance(held, np.ndarray)]
    if others:
        raise ValueError(f"its {others[0]} is no array")
    return arrays


def _motion(data: Mapping[str, np.ndarray]) -> Motion:
    if "moved" in data:
        return ControlPointMotion(data["times"], data["reference"], data["moved"])
    if "displacements" in data:
        nodes = data["displacements"]
        return FieldMotion(data["times"], _grid(data, nodes.shape[1:4]), nodes)
    if "shares" in data:
        shares = data["shares"]
        return PolyrigidMotion(data["times"], data["bodies"], _grid(data, shares.shape[1:]), shares)
    return RigidMotion(data["times"], data["moved_from_reference"])


def _grid(data: Mapping[str, np.ndarray], shape_zyx: tuple[int, int, int]) -> VolumeGrid:
    spacing, center = data["grid_spacing_xyz"].tolist(), data["grid_center"].tolist()
    return VolumeGrid(shape_zyx, tuple(spacing), tuple(center))
