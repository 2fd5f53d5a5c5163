import pytest

from legsim.opencl import discovery


def test_some_device_works_and_the_fastest_comes_first():
    seconds = [c.seconds for c in discovery.candidates() if c.seconds is not None]
    assert seconds
    assert seconds == sorted(seconds)


@pytest.mark.parametrize(
    ("machine", "system", "expected"),
    [
        ("x86_64", "linux", "pip install intel-opencl-rt"),
        ("AMD64", "win32", "pip install intel-opencl-rt"),
        ("aarch64", "linux", "apt install pocl-opencl-icd"),
        ("arm64", "darwin", "conda install -c conda-forge pocl"),
        ("x86_64", "darwin", "conda install -c conda-forge pocl"),
    ],
)
def test_the_named_runtime_exists_for_the_machine(machine, system, expected):
    assert discovery.installation(machine, system).startswith(expected)
