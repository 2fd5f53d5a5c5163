from typing import Never

import numpy as np
import pytest

from legsim import methods, opencl
from legsim.errors import LegsimError
from legsim.geometry import VolumeGrid
from legsim.signals import RigidMotion


def unwanted() -> Never:
    """What is not asked for is not made."""
    raise AssertionError("built without being run")


SETUP = methods.Setup(
    scheme="accurate",
    sensor="shank_l",
    legs=(),
    device=opencl.open_device(),
    nodes=VolumeGrid.cubic(2, 0.1, [0, 0, 0]),
    true_shank=RigidMotion.identity(np.arange(3.0)),
    true_field=unwanted,
    beads=unwanted,
)
OWN = """
from legsim.correction import Correction

def half(scan):
    return Correction("half", scan.projections, None)

nothing = 3
"""


@pytest.mark.parametrize("name", methods.BUILT_IN)
def test_every_built_in_method_can_be_built(name):
    assert callable(methods.build(name, SETUP))


def test_a_method_from_a_users_own_file(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    name = f"{tmp_path / 'own.py'}:half"
    assert getattr(methods.build(name, SETUP), "__name__", "") == "half"
    assert methods.label(name) == "half"


def test_editing_the_file_changes_the_fingerprint(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    name = f"{tmp_path / 'own.py'}:half"
    before = methods.fingerprint(name)
    (tmp_path / "own.py").write_text(OWN + "\n")
    assert methods.fingerprint(name) != before
    assert methods.fingerprint("rigid") == "rigid"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("magic", "no correction method named 'magic'; there are: static, uncorrected"),
        ("nowhere.py:half", r"nowhere\.py: no such file"),
        ("{own}:missing", "has no function 'missing'"),
        ("{own}:nothing", "has no function 'nothing'"),
    ],
)
def test_what_is_no_method_is_refused(tmp_path, name, message):
    (tmp_path / "own.py").write_text(OWN)
    with pytest.raises(LegsimError, match=message):
        methods.build(name.format(own=tmp_path / "own.py"), SETUP)
