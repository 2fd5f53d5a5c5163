import importlib.metadata
import sys
from dataclasses import replace
from pathlib import Path
from typing import Never, cast

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.correction.articulated_beads import BeadedLeg
from legsim.correction.bead_tracking import Reference
from legsim.correction.marker_based import MarkerBased
from legsim.deformation.models import RigidMotion
from legsim.geometry.volume import VolumeGrid
from legsim.opencl import device
from legsim.run import methods
from legsim.simulation.simulated_scan import ScanTruth


def unwanted(*_: object) -> Never:
    """What is not asked for is not made."""
    raise AssertionError("built without being run")


class Truth:
    """A leg at rest, whose field nobody may ask for."""

    field = unwanted

    def motion_of(self, segment: str) -> RigidMotion:
        assert segment == "tibia_l"
        return RigidMotion.identity(np.arange(3.0))


INPUTS = methods.MethodInputs(
    sensor="shank_l",
    scheme="accurate",
    device=device.open_device(),
    nodes=VolumeGrid.cubic(2, 0.1, [0, 0, 0]),
    scanned_shank="tibia_l",
    truth=cast(ScanTruth, Truth()),
    beads=unwanted,
    fused_beads=unwanted,
    fused_fiducials=unwanted,
    beaded_leg=BeadedLeg(unwanted, np.zeros(3)),
)


@pytest.mark.parametrize("reference", ["mean", "bundle"])
def test_the_beads_poses_are_fitted_to_what_the_inputs_name(reference: Reference):
    made = methods.build("marker-based", replace(INPUTS, bead_reference=reference))
    assert isinstance(made, MarkerBased)
    assert made.reference == reference


OWN = """
from legsim.correction import Correction

def half(scan):
    return Correction("half", scan.projections, None)

nothing = 3
"""


def offered(monkeypatch: pytest.MonkeyPatch, folder: Path, value: str, text: str = OWN) -> None:
    """An installed package whose module ``offered`` has this text offers ``value`` as the method
    "theirs".
    """
    (folder / "offered.py").write_text(text)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "offered", raising=False)
    point = importlib.metadata.EntryPoint("theirs", value, methods.ENTRY_POINTS)
    monkeypatch.setattr(
        importlib.metadata,
        "entry_points",
        lambda *, group: [point] if group == methods.ENTRY_POINTS else [],
    )


@pytest.mark.parametrize("name", methods.BUILT_IN)
def test_every_built_in_method_can_be_built(name):
    assert callable(methods.build(name, INPUTS))


def test_a_method_from_a_users_own_file(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    name = f"{tmp_path / 'own.py'}:half"
    assert callable(methods.build(name, INPUTS))
    assert methods.label(name) == "half"


def test_editing_the_file_changes_the_fingerprint(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    name = f"{tmp_path / 'own.py'}:half"
    before = methods.fingerprint(name)
    (tmp_path / "own.py").write_text(OWN + "\n")
    assert methods.fingerprint(name) != before
    assert methods.fingerprint("rigid") == "rigid"


def test_editing_an_installed_module_changes_the_fingerprint(tmp_path, monkeypatch):
    offered(monkeypatch, tmp_path, "offered:half")
    before = methods.fingerprint("theirs")
    (tmp_path / "offered.py").write_text(OWN + "\n")
    assert methods.fingerprint("theirs") != before


@pytest.mark.parametrize(
    ("value", "text", "message"),
    [
        ("offered:missing", OWN, "method theirs: offered:missing cannot be loaded"),
        ("offered:nothing", OWN, "method theirs: offered:nothing is not a function"),
        ("offered:half", "import nowhere_to_be_found", "cannot be loaded .ModuleNotFoundError"),
    ],
)
def test_an_installed_method_that_cannot_be_loaded_is_named(
    tmp_path, monkeypatch, value, text, message
):
    offered(monkeypatch, tmp_path, value, text)
    with pytest.raises(LegsimError, match=message):
        methods.build("theirs", INPUTS)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("magic", "unknown correction method 'magic'; known: static, uncorrected"),
        ("nowhere.py:half", r"nowhere\.py: no such file"),
        ("{own}:missing", "has no function 'missing'"),
        ("{own}:nothing", "has no function 'nothing'"),
        ("{broken}:half", r"broken\.py: cannot be imported .SyntaxError: .*; fix the file"),
    ],
)
def test_what_is_no_method_is_refused(tmp_path, name, message):
    (tmp_path / "own.py").write_text(OWN)
    (tmp_path / "broken.py").write_text("def half(scan:\n")
    with pytest.raises(LegsimError, match=message):
        methods.build(name.format(own=tmp_path / "own.py", broken=tmp_path / "broken.py"), INPUTS)


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("rigid@a/b", "rigid@a_b"),
        ("rigid@a:b", "rigid@a_b"),
        (r"rigid@..\\x", "rigid@..__x"),
        ("folder/x.py:mine", "mine"),
        ("rigid", "rigid"),
    ],
)
def test_a_label_is_a_name_of_a_file(name, label):
    assert methods.label(name) == label
