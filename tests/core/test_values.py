import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.core.values import frozen, increasing_times


def test_frozen_arrays_are_copied_once_and_cannot_be_written():
    source = np.arange(3.0)
    first = frozen("x", source, (3,))
    assert first is not source
    assert frozen("x", first, (None,)) is first
    with pytest.raises(ValueError, match="read-only"):
        first[0] = 1


def test_a_read_only_view_of_a_writable_array_is_copied():
    source = np.arange(3.0)
    view = source[:]
    view.flags.writeable = False
    assert frozen("x", view, (3,)) is not view


def test_an_array_over_foreign_memory_is_copied():
    stored = bytearray(np.arange(3.0).tobytes())
    view = np.frombuffer(stored)
    view.flags.writeable = False
    kept = frozen("x", view, (3,))
    stored[:] = bytes(len(stored))
    np.testing.assert_array_equal(kept, [0, 1, 2])


def test_wrong_shapes_are_named():
    with pytest.raises(LegsimError, match=r"x has shape \(3,\); expected \('any', 3\)"):
        frozen("x", np.zeros(3), (None, 3))


def test_times_must_increase():
    np.testing.assert_array_equal(increasing_times("t", [0, 1, 3]), [0, 1, 3])
    with pytest.raises(LegsimError, match="sample 2"):
        increasing_times("t", [0, 1, 1])
