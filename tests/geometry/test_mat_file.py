"""MATLAB's files: what scipy writes is read, and damage is refused where scipy ends the process."""

import struct

import numpy as np
import pytest
from scipy.io import savemat

from legsim.geometry import mat_file


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u2", "i4", "u8"])
def test_arrays_of_every_type_come_back(tmp_path, rng, kind, compressed):
    values = rng.uniform(0, 100, (3, 4, 5)).astype(kind)
    written = {"P": values, "flat": values[:, 0, 0], "words": "scan", "z": np.array([1j])}
    savemat(tmp_path / "m.mat", written, do_compression=compressed)
    found = mat_file.arrays((tmp_path / "m.mat").read_bytes())
    assert found["P"] is not None
    np.testing.assert_array_equal(found["P"], values)
    np.testing.assert_array_equal(found["flat"], values[:, 0, 0][None])
    assert (found["words"], found["z"]) == (None, None)
    assert list(found) == list(written)


def whole(tmp_path) -> bytes:
    savemat(tmp_path / "m.mat", {"P": np.arange(12.0).reshape(3, 4)})
    return (tmp_path / "m.mat").read_bytes()


@pytest.mark.parametrize("kind", [0x7FFF, 0x7FFF0000, 10, 0])
def test_an_unknown_type_of_numbers_is_refused(tmp_path, kind):
    data = bytearray(whole(tmp_path))
    place = data.rindex(struct.pack("<II", 9, 96))
    struct.pack_into("<I", data, place, kind)
    with pytest.raises(ValueError, match=r"type|numbers for the size|are there"):
        mat_file.arrays(bytes(data))


def test_a_file_that_breaks_off_is_refused_wherever_it_does(tmp_path):
    data = whole(tmp_path)
    for end in range(136, len(data)):
        with pytest.raises(ValueError):
            mat_file.arrays(data[:end])


def test_another_size_than_its_numbers_is_refused(tmp_path):
    data = whole(tmp_path).replace(struct.pack("<ii", 3, 4), struct.pack("<ii", 3, 5))
    with pytest.raises(ValueError, match=r"P has 12 numbers for the size \(3, 5\)"):
        mat_file.arrays(data)


def test_version_73_is_told_apart(tmp_path):
    data = bytearray(whole(tmp_path))
    data[124:126] = struct.pack("<H", 0x200)
    with pytest.raises(NotImplementedError):
        mat_file.arrays(bytes(data))
