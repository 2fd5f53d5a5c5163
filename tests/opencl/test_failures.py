"""A device that fails halfway ends in one line, whatever it says."""

import numpy as np
import pyopencl as cl
import pytest

from legsim.core.errors import LegsimError
from legsim.opencl import failures


def test_memory_that_does_not_suffice_is_reported_with_the_fix(device):
    with (
        pytest.raises(LegsimError, match=r"its memory does not suffice .* --device cpu") as caught,
        failures.reported(device.label),
    ):
        device.zeros(1 << 45, np.float32)
    assert device.label in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(caught.value).endswith("finished stages are kept")


@pytest.mark.parametrize("kind", [cl.LogicError, cl.RuntimeError, cl.Error])
def test_a_lost_device_is_reported_with_the_fix(kind):
    error = kind("gone\nfor good")
    with (
        pytest.raises(LegsimError, match=r"OpenCL device X failed \(gone\); run this again"),
        failures.reported("X"),
    ):
        raise error


def test_other_errors_pass(device):
    with pytest.raises(ZeroDivisionError), failures.reported(device.label):
        raise ZeroDivisionError
