"""Files that OpenSim opens although they are no XML."""

from xml.etree import ElementTree

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.kinematics import osim_file, osim_xml
from legsim.kinematics.osim_leg import OsimLeg
from tests.examples import osim


@pytest.mark.parametrize(
    "credits",
    [b"829\x96840, Universit\xe9", b"Smith, C. R., & Thelen, D. G.", b"A &amp; B &#38; C"],
)
def test_credits_in_a_code_page_or_with_a_bare_ampersand_do_not_hinder(tmp_path, credits):
    text = osim.version_4(osim.two_legs(), markers=osim.MARKERS).encode()
    path = tmp_path / "m.osim"
    path.write_bytes(text.replace(b"<BodySet>", b"<credits>" + credits + b"</credits><BodySet>"))
    assert len(OsimLeg(osim_file.read(path)).marker_sites()[0].names) == 22


def test_a_file_in_utf_16_is_read(tmp_path):
    path = tmp_path / "m.osim"
    path.write_bytes(osim.version_4(osim.two_legs(), markers=osim.MARKERS).encode("utf-16"))
    assert len(OsimLeg(osim_file.read(path)).marker_sites()[0].names) == 22


def test_legs_named_without_and_with_an_l_are_right_and_left(tmp_path):
    text = osim.version_4(osim.two_legs(), markers=osim.MARKERS)
    plain = OsimLeg(osim_file.read(osim.saved(tmp_path, text)))
    for part in ("femur", "tibia", "talus"):
        text = text.replace(f"{part}_r", part).replace(f"{part}_l", f"l{part}")
    arnold = OsimLeg(osim_file.read(osim.saved(tmp_path, text, "arnold.osim")))
    assert arnold.body_of("tibia_l") == "ltibia"
    values = plain.default_coordinates[None] + 0.1
    ours, theirs = (leg.kinematics(values).origins for leg in (arnold, plain))
    np.testing.assert_array_equal(ours, theirs)


def test_a_marker_that_is_there_twice_counts_once_and_two_places_are_refused(tmp_path):
    first, _, rest = osim.MARKERS.partition("</Marker>")
    twice = f"{first}</Marker>{first}</Marker>{rest}"
    path = osim.saved(tmp_path, osim.version_4(osim.two_legs(), markers=twice))
    assert len(OsimLeg(osim_file.read(path)).marker_sites()[0].names) == 22
    other = f"{first}</Marker>{first.replace('0.12', '0.13')}</Marker>{rest}"
    path = osim.saved(tmp_path, osim.version_4(osim.two_legs(), markers=other))
    with pytest.raises(LegsimError, match="two markers are named pelvis_M0, on pelvis and pelvis"):
        OsimLeg(osim_file.read(path)).marker_sites()


@pytest.mark.parametrize(("inside", "is_set"), [
    ("<a>true</a>", True), ("<a> TRUE </a>", True), ("<a>1</a>", True), ("<a>false</a>", False),
    ("<a>0</a>", False), ("", None), ("<a/>", None), ("<a> </a>", None),
])  # fmt: skip
def test_flags_are_read_as_opensim_reads_them(inside, is_set):
    element = ElementTree.fromstring(f"<e>{inside}</e>")
    for missing in (False, True):
        assert osim_xml.flag(element, "a", missing=missing) is (
            missing if is_set is None else is_set
        )
