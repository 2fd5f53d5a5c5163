"""Long lines of an NRRD are read where they may be long, and never end the process."""

import subprocess
import sys

import numpy as np
import pytest
import SimpleITK as sitk

from legsim.core.errors import LegsimError
from legsim.geometry import image_files
from legsim.geometry.volume import Volume, VolumeGrid

LONG = 2000 * b"x"


@pytest.fixture
def with_line(tmp_path, rng):
    """An NRRD with one line more in its header."""
    volume = Volume(VolumeGrid.cubic(4, 1e-3, [0, 0, 0]), rng.random((4, 4, 4), np.float32))
    image_files.save_volume(tmp_path / "a.nrrd", volume)
    header, numbers = (tmp_path / "a.nrrd").read_bytes().split(b"\n\n", 1)

    def made(line: bytes):
        (tmp_path / "b.nrrd").write_bytes(header + b"\n" + line + b"\n\n" + numbers)
        return tmp_path / "b.nrrd", volume

    return made


@pytest.mark.parametrize(
    "line", [b"# " + LONG, b"key:=" + LONG, b"key:=a: " + LONG, LONG + b":=1", b"Content: " + LONG]
)
def test_lines_that_may_be_long_are_read(with_line, line):
    path, volume = with_line(line)
    np.testing.assert_allclose(
        image_files.load_volume(path).attenuation, volume.attenuation, rtol=1e-6
    )


@pytest.mark.parametrize(
    "line", [LONG, b"kinds: " + LONG, LONG + b": 3", b"kinds: " + LONG + b":=3", b" # " + LONG]
)
def test_fields_that_are_too_long_are_refused(with_line, line):
    path, _ = with_line(line)
    with pytest.raises(LegsimError, match=r"b\.nrrd \(line \d+\): its header has a line of 2\d+ b"):
        image_files.load_volume(path)


def test_the_longest_line_that_is_handed_on_does_not_end_the_process(with_line):
    path, _ = with_line(b"kinds: " + 790 * b"x")
    program = "import sys; from legsim.geometry import image_files as i; i.load_volume(sys.argv[1])"
    ended = subprocess.run([sys.executable, "-c", program, path], capture_output=True, check=False)
    assert ended.returncode == 1
    assert b"LegsimError" in ended.stderr


def test_lengths_in_another_unit_are_refused(with_line):
    path, _ = with_line(b'space units: "mm" "cm" "cm"')
    with pytest.raises(LegsimError, match=r"line \d+\): its lengths are in 'cm'; write it in mm"):
        image_files.load_volume(path)
    for same in (b'"mm" "mm" "mm"', b'"" "" ""', b'"???" "???" "???"', b'"millimeters" "MM" "mm"'):
        image_files.load_volume(with_line(b"space units: " + same)[0])


@pytest.mark.parametrize("field", [b"Space Units", b"SPACE UNITS", b"spaceunits"])
def test_units_are_looked_at_in_all_spellings_that_itk_reads(with_line, field):
    path, _ = with_line(field + b': "um" "um" "um"')
    assert sitk.ReadImage(str(path)).GetDimension() == 3, "ITK passes over it"
    with pytest.raises(LegsimError, match=r"its lengths are in 'um'; write it in mm"):
        image_files.load_volume(path)


def test_units_of_axes_are_looked_at(with_line):
    """`units` belongs to files with `spacings`, without a space."""
    path, _ = with_line(b"kinds: domain domain domain")
    head, numbers = path.read_bytes().split(b"\n\n", 1)
    kept = [line for line in head.split(b"\n") if not line.startswith((b"space", b"kinds"))]
    lines = [*kept, b"spacings: 2 2 3", b'units: "um" "um" "um"']
    path.write_bytes(b"\n".join(lines) + b"\n\n" + numbers)
    assert sitk.ReadImage(str(path)).GetSpacing() == (2, 2, 3), "ITK passes over it"
    with pytest.raises(LegsimError, match=r"its lengths are in 'um'; write it in mm"):
        image_files.load_volume(path)


def test_a_key_that_is_called_units_is_no_field(with_line):
    path, volume = with_line(b'units:="um"')
    np.testing.assert_allclose(
        image_files.load_volume(path).attenuation, volume.attenuation, rtol=1e-6
    )
