"""Roles are found among a recording's labels in spite of prefixes and spelling, and never by
chance.
"""

import pytest

from legsim.core.errors import LegsimError
from legsim.mocap import labels
from legsim.mocap.labels import PAPER_ROLES, MarkerMap

LABELS = ("SACR", "RASI", "LASI", "RKNE", "LKNE", "RANK", "LANK")
SEVEN = MarkerMap.one_to_one("seven", PAPER_ROLES, LABELS)


@pytest.mark.parametrize("spelling", [
    "{}", "Subject:{}", "Sehoon VSK35:{}", "Lab:Subject:{}", "genou1_{}",
    "S01.{}", "Skeleton 001 {}", "S_01_{}", "{}_1", "{}.pos", "Ann:{} - 1",
])  # fmt: skip
def test_prefixes_are_looked_through(spelling):
    names = [spelling.format(label) for label in LABELS]
    assert SEVEN.found_in(names) == {
        role: (name,) for role, name in zip(PAPER_ROLES, names, strict=True)
    }


@pytest.mark.parametrize("label", ["RASI", "rasi", "R.ASI", "R_ASI", "r asi"])
def test_case_and_punctuation_are_looked_through(label):
    assert SEVEN.found_in([label, "other"]) == {"asis_r": (label,)}


def test_the_exact_spelling_goes_first():
    assert SEVEN.found_in(["rasi", "RASI"])["asis_r"] == ("RASI",)


def test_a_label_that_is_the_prefix_alone_hides_no_other():
    names = [*(f"S01_{label}" for label in LABELS), "S01_"]
    assert SEVEN.missing_in(names) == ()


@pytest.mark.parametrize(
    "names", [("A:RASI", "B:RASI"), ("rasi", "R.ASI"), ("RASI#1", "RASI#2"), ("*RASI", "x")]
)
def test_what_could_be_either_is_neither(names):
    assert SEVEN.found_in(names) == {}


def test_several_labels_play_a_role_only_together():
    middle = MarkerMap("m", ("sacrum",), ((("RPSI", "LPSI"),),))
    assert middle.found_in(["LPSI", "RPSI"]) == {"sacrum": ("RPSI", "LPSI")}
    assert middle.found_in(["LPSI"]) == {}


def test_the_first_alternative_that_is_there_is_taken():
    either = MarkerMap("m", ("sacrum",), ((("SACR",), ("RPSI", "LPSI")),))
    assert either.found_in(["LPSI", "RPSI", "SACR"])["sacrum"] == ("SACR",)
    assert either.found_in(["LPSI", "RPSI"])["sacrum"] == ("RPSI", "LPSI")


def test_the_set_that_covers_most_is_guessed():
    small = MarkerMap.one_to_one("small", PAPER_ROLES, LABELS)
    large = MarkerMap.one_to_one("large", (*PAPER_ROLES, "heel_r"), (*LABELS, "RHEE"))
    assert labels.guess([small, large], (*LABELS, "RHEE")).name == "large"
    assert labels.guess([small, large], LABELS).name == "small"


def test_what_is_missing_and_what_is_there_is_reported_in_one_line():
    with pytest.raises(
        LegsimError,
        match=r"'seven' finds no marker for epicondyle_lateral_r among .*LKNE.*give a marker map",
    ) as caught:
        labels.guess([SEVEN], [label for label in LABELS if label != "RKNE"])
    assert "\n" not in str(caught.value)


def test_a_recording_of_something_else_is_reported():
    with pytest.raises(
        LegsimError,
        match=(
            r"no marker set knows any of the markers chair, table; give a marker map \(TOML\) "
            r"with sacrum"
        ),
    ):
        labels.guess([SEVEN], ["chair", "table"])


def test_required_roles_can_be_chosen():
    assert labels.guess([SEVEN], ["RASI"], required=()).name == "seven"


@pytest.mark.parametrize(("role", "segment"), [
    ("sacrum", "pelvis"), ("asis_l", "pelvis"), ("epicondyle_medial_r", "femur_r"), ("malleolus_lateral_l", "tibia_l"),
    ("heel_r", "calcn_r"), ("toe_l", "calcn_l"), ("thigh_3_r", "femur_r"), ("shank_rear_l", "tibia_l"), ("tibial_tuberosity_r", "tibia_r"),
])  # fmt: skip
def test_every_role_sits_on_a_segment(role, segment):
    assert labels.segment_of(role) == segment


@pytest.mark.parametrize("role", ["sacrum_r", "asis", "knee_r", "thigh_12_r", ""])
def test_an_unknown_role_is_refused_with_the_known_ones(role):
    with pytest.raises(LegsimError, match=r"no role is named .* there are sacrum, asis_r"):
        MarkerMap.one_to_one("m", (role,), ("A",))


def test_a_role_is_there_once():
    with pytest.raises(LegsimError, match="role sacrum is there twice"):
        MarkerMap.one_to_one("m", ("sacrum", "sacrum"), ("A", "B"))


def seven_with(**changed) -> MarkerMap:
    """The seven roles, some under other labels."""
    entries = {role: ((label,),) for role, label in zip(PAPER_ROLES, LABELS, strict=True)}
    entries |= changed
    return MarkerMap("mine", tuple(entries), tuple(entries.values()))


@pytest.mark.parametrize("label", ["RKNE", "rkne", "R.KNE", "Ann:RKNE"])
def test_one_marker_for_two_roles_is_refused_however_it_is_spelled(label):
    both_knees = seven_with(epicondyle_lateral_l=((label,),))
    names = [f"Ann:{name}" for name in LABELS] if ":" in label else LABELS
    with pytest.raises(LegsimError, match=(
        r"'mine': (Ann:)?RKNE plays both epicondyle_lateral_r and epicondyle_lateral_l; give each"
    )):  # fmt: skip
        labels.check_distinct(both_knees, both_knees.found_in(names))


def test_a_middle_of_one_marker_with_itself_is_refused():
    middle = seven_with(sacrum=(("SACR", "sacr"),))
    with pytest.raises(LegsimError, match="sacrum is the middle of SACR and SACR, one marker"):
        labels.check_distinct(middle, middle.found_in(LABELS))


def test_a_marker_on_two_segments_is_refused_also_as_part_of_a_middle():
    bridge = seven_with(epicondyle_lateral_l=(("LKNE", "LANK"),))
    with pytest.raises(LegsimError, match="LANK plays both epicondyle_lateral_l and malleolus"):
        labels.check_distinct(bridge, bridge.found_in(LABELS))


def test_a_sacrum_between_the_posterior_spines_shares_them():
    spines = seven_with(sacrum=(("RPSI", "LPSI"),), psis_r=(("RPSI",),), psis_l=(("LPSI",),))
    labels.check_distinct(spines, spines.found_in((*LABELS, "RPSI", "LPSI")))


def with_psis(sacrum):
    """A map of a sacrum, both posterior spines and two front ones."""
    roles = ("sacrum", "psis_r", "psis_l", "asis_r", "asis_l")
    alone = tuple(((name,),) for name in ("RPSI", "LPSI", "RASI", "LASI"))
    return MarkerMap("psis", roles, ((sacrum,), *alone))


def test_a_mean_of_markers_that_play_roles_themselves_is_known_as_such():
    labels_of = ("RPSI", "LPSI", "RASI", "LASI", "SACR")
    assert with_psis(("RPSI", "LPSI")).means_in(labels_of) == ("sacrum",)
    assert with_psis(("SACR",)).means_in(labels_of) == ()
    assert with_psis(("RPSI", "SACR")).means_in(labels_of) == ()
    lone = MarkerMap("lone", ("sacrum",), ((("RPSI", "LPSI"),),))
    assert lone.means_in(labels_of) == ()


def test_both_posterior_spines_do_for_the_sacrum():
    without = with_psis(("SACR",)).without(["sacrum"])
    assert without.roles == ("psis_r", "psis_l", "asis_r", "asis_l")
    needed = ("sacrum", "asis_r")
    assert without.missing_in(("RPSI", "LPSI", "RASI"), needed) == ()
    assert without.missing_in(("RPSI", "RASI"), needed) == ("sacrum",)


def test_a_map_without_a_role_keeps_the_segments_of_the_others():
    own = MarkerMap.one_to_one("own", ("A", "B"), ("A", "B"), ("pelvis", "tibia_r"))
    assert own.without(["A"]).segment("B") == "tibia_r"


def test_names_are_found_among_labels_whatever_their_spelling():
    assert labels.find_labels(["r_asi", "nose"], ["S:RASI", "S:LASI"]) == {"r_asi": "S:RASI"}


def test_what_only_some_names_begin_or_end_with_is_theirs():
    assert labels.without_shared_ends(["RASI_1", "LASI_2"]) == ["RASI_1", "LASI_2"]
    assert labels.without_shared_ends(["R_ASI", "R_ASI_top"]) == ["ASI", "ASI_top"]
    assert labels.without_shared_ends(["RASI", "RKNE"]) == ["RASI", "RKNE"]
    assert labels.without_shared_ends(["a_b", "a_"]) == ["b", "a_"]
    assert labels.without_shared_ends(["a_b_a", "a_a"]) == ["b", "a_a"]
    assert labels.without_shared_ends(["S_RASI"]) == ["S_RASI"]
    assert labels.without_shared_ends(["S_RASI", "*17", "S_C7"]) == ["RASI", "*17", "C7"]


def test_numbers_before_all_labels_are_looked_through():
    marker_map = MarkerMap.one_to_one("m", ["asis_r", "heel_l"], ["R_ASIS", "LHEE"])
    found = marker_map.found_in(["1 - Head", "12 - R_ASIS", "13 - LHEE"])
    assert found == {"asis_r": ("12 - R_ASIS",), "heel_l": ("13 - LHEE",)}
    assert marker_map.found_in(["Head", "12 - R_ASIS"]) == {}
    assert MarkerMap.one_to_one("m", ["meta5_r"], ["MT"]).found_in(["5MT", "1.2"]) == {}


@pytest.mark.parametrize("who", ["01-Bob:", "1 - P:", "01.Bob:"])
@pytest.mark.parametrize("beside", [[], ["02-Wand:W1", "02-Wand:W2"], ["01.Chair:C1", "chair"]])
def test_the_number_of_a_subject_is_no_count_of_its_markers(who, beside):
    names = [who + label for label in LABELS]
    assert SEVEN.found_in([*names, *beside]) == {
        role: (name,) for role, name in zip(PAPER_ROLES, names, strict=True)
    }


def test_a_count_is_looked_through_once_and_behind_a_prefix():
    names = [f"Bob:{k}-{label}" for k, label in enumerate(LABELS)]
    assert SEVEN.missing_in(names) == ()
    knee = MarkerMap.one_to_one("m", ["epicondyle_lateral_r"], ["R_KneeLat"])
    assert knee.found_in(["4-R_Knee2.Lat", "5-L_Knee2.Lat"]) == {}
    assert knee.found_in(["4-R_Knee.Lat", "5-L_Knee.Lat"])


def test_letters_of_other_alphabets_part_labels_and_accents_do_not():
    knee = MarkerMap.one_to_one("m", ["epicondyle_lateral_r"], ["RKnee"])
    assert knee.found_in(["R_Knee\u5167", "L_Knee\u5167"]) == {}
    assert knee.found_in(["R_Kne\u00e9", "L_Kne\u00e9"])
