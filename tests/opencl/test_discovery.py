import dataclasses

import pyopencl as cl
import pytest

from legsim.core.errors import LegsimError
from legsim.opencl import device as opencl_device
from legsim.opencl import discovery


def test_some_device_works_and_the_fastest_comes_first():
    seconds = [c.seconds for c in discovery.candidates() if c.seconds is not None]
    assert seconds
    assert seconds == sorted(seconds)


WRONG = [
    ("sum += table[j]", "sum += 1.001f * table[j]", "returned wrong numbers"),
    ("out[i] = sum", "if (i != 5000) out[i] = sum", "returned wrong numbers"),
    ("out[i] = sum", "out[i] = NAN", "returned wrong numbers"),
    ("shared[own + reach]", "shared[own]", "wrong sums of a work-group"),
    ("atomic_inc(&counts[value & 7])", "counts[0] = 1", "wrong atomic counts"),
    ("i % 1009", "i % 1000 ? i % 1009 : 7", "wrong sums of a work-group"),
]
"""Drivers that build but compute wrongly, as what they would make of the probe"""


@pytest.mark.parametrize(("right", "wrong", "failure"), WRONG)
def test_a_driver_that_computes_wrongly_is_not_taken(monkeypatch, right, wrong, failure):
    assert right in discovery._PROBE
    monkeypatch.setattr(discovery, "_PROBE", discovery._PROBE.replace(right, wrong))
    for candidate in discovery.candidates.__wrapped__():
        assert candidate.seconds is None
        assert failure in candidate.failure


def test_a_driver_that_does_not_build_says_why(monkeypatch):
    monkeypatch.setattr(discovery, "_PROBE", "__kernel void probe() { nonsense; }")
    for candidate in discovery.candidates.__wrapped__():
        assert candidate.seconds is None
        assert "error:" in candidate.failure
        assert "\n" not in candidate.failure


@pytest.mark.parametrize("largest", [1, 16, 100])
def test_the_probe_fits_devices_of_small_work_groups(device, largest):
    context, queue = device.context, device.queue
    kernel = discovery.build_program(context, discovery._PROBE, []).groups
    discovery._check_groups(context, queue, kernel, largest)


def test_a_platform_that_fails_leaves_the_others(monkeypatch):
    class Broken:
        name = "broken"

        def get_devices(self) -> list:
            raise cl.LogicError("DEVICE_NOT_FOUND")

    working = cl.get_platforms()
    monkeypatch.setattr(cl, "get_platforms", lambda: [Broken(), *working])
    found = {c.label for c in discovery.candidates.__wrapped__()}
    assert found == {c.label for c in discovery.candidates()}


def test_of_several_devices_those_that_compute_wrongly_are_never_opened(monkeypatch):
    good = next(c for c in discovery.candidates() if c.seconds is not None)
    wrong = dataclasses.replace(good, name="Wrong", seconds=None, failure="wrong numbers")
    monkeypatch.setattr(opencl_device, "candidates", lambda: (good, wrong))
    assert opencl_device.open_device().candidate == good
    with pytest.raises(LegsimError, match="no working OpenCL device matches 'wrong'"):
        opencl_device.open_device("wrong")
