"""Whether the numbers of a C3D file are those that the sign of its scale says: floating-point
numbers where it is negative, whole ones where it is positive.

Programs that write the one and say the other make files whose markers are scattered over
kilometers, or that seem to end half way.
"""

from dataclasses import replace

import numpy as np

from legsim.mocap._c3d_header import BLOCK, C3dHeader, floats

_SOME = 50
"""frames that are looked at"""

_SMALLEST, _LARGEST = 1e-4, 1e6
"""magnitudes of floating-point numbers of laboratories; pairs of whole numbers look like others"""

_MOST = 0.9
"""of the numbers"""


def with_true_sign(header: C3dHeader, data: bytes) -> C3dHeader:
    """The header, with the other sign of its scale, and a note, where the numbers demand it."""
    if header.scale == 0 or not np.isfinite(header.scale) or header.data_block < 2:
        return header
    numbers = 4 * header.points + header.analog_words
    room = len(data) - (header.data_block - 1) * BLOCK
    count = (header.last_frame - header.first_frame + 1) * numbers
    if count < 1 or room < 2 * count:
        return header
    start = (header.data_block - 1) * BLOCK
    some = min(_SOME * numbers, room // 4)
    size = np.abs(floats(data[start : start + 4 * some], header.processor))
    usual = ((size >= _SMALLEST) & (size <= _LARGEST)) | (size == 0)
    of_floats = bool(usual.mean() > _MOST) and bool((size > 0).any())
    if header.scale > 0 and of_floats and room >= 4 * count:
        return _turned(header, "floating-point")
    # a file of floats that was cut short has room for more than whole numbers
    whole = room < min(4 * count, 2 * count + 2 * BLOCK)
    if header.scale < 0 and not of_floats and whole:
        return _turned(header, "whole")
    return header


def _turned(header: C3dHeader, what: str) -> C3dHeader:
    note = (
        f"warning: by the sign of its scale ({header.scale:g}) the file holds other numbers than "
        f"it does: read as {what} numbers; export it again if its lengths are not right"
    )
    return replace(header, scale=-header.scale, notes=(*header.notes, note))
