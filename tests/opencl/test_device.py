import os
import subprocess
import sys

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.opencl import device as opencl_device
from legsim.opencl.device import open_device


def test_an_array_survives_the_way_to_the_device_and_back(device, rng):
    data = rng.normal(size=1000).astype(np.float32)
    np.testing.assert_array_equal(device.download(device.upload(data), np.empty_like(data)), data)


def test_fresh_buffers_hold_zeros(device):
    assert not device.download(device.zeros(1000, np.int32), np.ones(1000, np.int32)).any()


def test_the_same_label_gives_the_same_open_device(device):
    assert open_device(device.label) is device


def test_a_wish_that_cannot_be_met_lists_what_there_is():
    with pytest.raises(
        LegsimError, match=r"no working OpenCL device matches 'abacus'.*there are: .+"
    ):
        open_device("abacus")


def test_the_environment_variable_chooses(monkeypatch):
    monkeypatch.setenv("LEGSIM_DEVICE", "abacus")
    with pytest.raises(LegsimError, match="LEGSIM_DEVICE"):
        open_device()


def test_a_setting_that_names_no_runtime_is_named_in_one_line(tmp_path):
    (tmp_path / "none.icd").write_text("/nowhere/libnone.so\n")
    environment = os.environ | {
        "OCL_ICD_VENDORS": str(tmp_path / "none.icd"),
        "OPENCL_VENDOR_PATH": str(tmp_path),
    }
    script = (
        "from legsim.core import LegsimError\nfrom legsim.opencl import open_device\n"
        "try:\n    open_device()\nexcept LegsimError as e:\n    print(e)"
    )
    result = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
    )
    assert "no OpenCL device works" in result.stdout
    assert "/nowhere/libnone.so, which is not there; unset it" in result.stdout
    assert len(result.stdout.splitlines()) == 1


def test_without_any_runtime_the_line_says_what_to_install(monkeypatch):
    monkeypatch.setattr(opencl_device, "candidates", lambda: ())
    monkeypatch.delenv("OCL_ICD_VENDORS", raising=False)
    with pytest.raises(LegsimError, match=r"the OpenCL loader lists no device.*pip install intel"):
        open_device()


def test_the_limits_of_work_groups_are_the_devices(device):
    assert device.group_size >= 1
    assert device.local_bytes >= 1024


def test_a_device_prints_as_one_short_line_with_units(device):
    text = repr(device)
    assert text.startswith(f"Device({device.label}, ")
    assert text.endswith(" GiB)")
    assert len(text) < 120


@pytest.mark.parametrize("counts", [(1, 1, 1), (5, 37, 2), (512, 512, 3), (509, 1, 7)])
def test_groups_cover_the_work_and_fit_the_device(device, counts):
    kernel = device.kernel("read_points", "textures.cl")
    sizes, group = device.grouped(kernel, counts)
    assert sizes[2] == counts[2]
    assert group[0] * group[1] * group[2] <= device.group_size
    for size, count, local in zip(sizes, counts, group, strict=True):
        assert size % local == 0
        assert count <= size < count + local
