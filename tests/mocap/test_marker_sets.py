"""The shipped marker sets are sound and fit the recordings they were made for; a user's own is
checked.
"""

import re
from pathlib import Path

import pytest

from legsim.core.errors import LegsimError
from legsim.mocap import files, marker_sets
from legsim.mocap.labels import PAPER_ROLES, segment_of

RECORDINGS = {
    "standing_bmc/static_run.trc": "rajagopal",
    "standing_biobuddy/anat_pose_ECH.c3d": "cast",
    "standing_c3dio/Capture0008_Standing.c3d": "knee_joint_line",
    "squat_dart/squat.c3d": "vicon_waist",
    "squats_subject4/squats1.trc": "opencap",
    "squats_subject4/static1.trc": "opencap",
    "walk_opensim/subject01_static.trc": "gait2392",
}


@pytest.mark.parametrize("name", marker_sets.names())
def test_a_shipped_set_covers_the_seven_roles_on_both_sides(name):
    marker_map = marker_sets.load(name)
    assert set(PAPER_ROLES) <= set(marker_map.roles)
    mirrored = {
        role[:-2] + {"_r": "_l", "_l": "_r"}[role[-2:]]
        for role in marker_map.roles
        if role != "sacrum"
    }
    assert mirrored == set(marker_map.roles) - {"sacrum"}
    assert all(segment_of(role) for role in marker_map.roles)


@pytest.mark.parametrize("name", marker_sets.names())
def test_a_shipped_set_is_guessed_from_its_own_labels(name):
    marker_map = marker_sets.load(name)
    labels = sorted(
        {label for alternatives in marker_map.alternatives for label in alternatives[0]}
    )
    guessed = marker_sets.guess(labels)
    assert guessed.name == name
    assert set(guessed.found_in(labels)) == set(marker_map.roles)


@pytest.mark.parametrize(("file", "name"), RECORDINGS.items())
def test_the_set_of_a_real_recording_is_guessed(shared_data, file, name):
    # Y_SCREEN of one calls -z up, where its feet are
    up = "z" if "anat_pose" in file else None
    labels = files.load_markers(shared_data / "mocap" / file, up=up).marker_names
    guessed = marker_sets.guess(labels)
    assert guessed.name == name
    assert guessed.missing_in(labels) == ()


SIDES = ("R", "L")

STATIC = ["SACRUM"] + [
    f"{s}_{name}"
    for s in SIDES
    for name in ("ASIS", "KNEE_LAT", "ANKLE_LAT", "HEEL", "MT_5", "THIGH_1", "SHANK_1", "SHANK_2")
]
"""labels that no single set covers"""


def test_a_trial_is_read_by_the_set_of_the_static_trial_that_it_is_scaled_from():
    walk = [name for name in STATIC if "_LAT" not in name]
    found = marker_sets.guess_beside(walk, STATIC)
    assert found.name == marker_sets.guess(STATIC).name == "common_names"
    shown = {"sacrum"} | {
        f"{role}_{s.lower()}"
        for s in SIDES
        for role in ("asis", "heel", "meta5", "thigh_1", "shank_1", "shank_2")
    }
    assert set(found.found_in(walk)) == shown


def test_a_trial_of_other_labels_than_its_static_is_read_by_its_own_set():
    plug_in = [labels[0] for a in marker_sets.load("plug_in_gait").alternatives for labels in a]
    assert marker_sets.guess_beside(plug_in, STATIC).name == "plug_in_gait"


def test_a_walk_without_lateral_markers_is_refused_unless_they_are_not_required(shared_data):
    labels = files.load_markers(shared_data / "mocap/walk_opensim/subject01_walk1.trc").marker_names
    with pytest.raises(
        LegsimError,
        match=(
            r"'gait2392' finds no marker for epicondyle_lateral_r, epicondyle_lateral_l, "
            r"malleolus"
        ),
    ):
        marker_sets.guess(labels)
    assert len(marker_sets.guess(labels, required=()).found_in(labels)) == 27


def both(words: str) -> list[str]:
    """Each word with R and with L for its @."""
    return [word.replace("@", side) for word in words.split() for side in "RL"]


@pytest.mark.parametrize(
    ("labels", "knee", "ankle"),
    [
        ([*both("@ASIS @LEK @MEK @LM @MM"), "SACR"], "RLEK", "RLM"),
        (both("@ASIS @PSIS @KNE @ANK"), "RKNE", "RANK"),
        (both("@ASI @PSI @LE @LM"), "RLE", "RLM"),
        (both("@ASI @PSI @KNEL @KNEM @ANKL @ANKM"), "RKNEL", "RANKL"),
        (["SACRUM", *both("@ASIS @_Knee_Lateral "
            "@_Ankle_Lateral")], "R_Knee_Lateral", "R_Ankle_Lateral"),
        (["sacrum", *(f"{s}_{w}" for s in ("right", "left") for w in ("asis", "lateral_epicondyle", "lateral_malleolus"))],
         "right_lateral_epicondyle", "right_lateral_malleolus"),
        ([(f"{s} "
            f"{w}") for s in ("Right", "Left") for w in ("ASIS", "PSIS", "Knee", "Ankle")], ("Right "
            "Knee"), ("Right "
            "Ankle")),
        (["VSAC", *both("@ASI @LEPI @MEPI @LMA @MMA")], "RLEPI", "RLMA"),
        (["VSAC", *both("@ASI @LEPI @MEPI @LAK @MAK")], "RLEPI", "RLAK"),
        (["VSACR", *both("@ASI @LKNEE @MKNEE @LANKLE @MANKLE")], "RLKNEE", "RLANKLE"),
        (["SACR", *(f"{w}_{s}" for w in ("ASIS", "KNEE", "ANKLE") for s in "RL")], "KNEE_R", "ANKLE_R"),
    ],
)  # fmt: skip
def test_names_of_several_sets_are_understood_together(labels, knee, ankle):
    found = marker_sets.guess(labels).found_in(labels)
    assert (found["epicondyle_lateral_r"], found["malleolus_lateral_r"]) == ((knee,), (ankle,))
    assert set(PAPER_ROLES) <= set(found)


def test_the_medial_marker_beside_a_knee_alignment_device_is_at_the_ankle():
    found = marker_sets.load("plug_in_gait").found_in(["RKNE", "RANK", "RMED", "LMED"])
    assert found["malleolus_medial_r"] == ("RMED",)
    assert found["malleolus_medial_l"] == ("LMED",)
    assert "epicondyle_medial_r" not in found


@pytest.mark.parametrize(
    ("labels", "knee"),
    [
        (["Knie_lateral_rechts", "Knie_lateral_links"], "Knie_lateral_rechts"),
        (["ginocchio_lat_dx", "ginocchio_lat_sx"], "ginocchio_lat_dx"),
        (["KneeLateral_Right", "KneeLateral_Left"], "KneeLateral_Right"),
        (both("@LatFemEpi"), "RLatFemEpi"),
        (both("@_Knee_Outer"), "R_Knee_Outer"),
        (both("CondyleLat@"), "CondyleLatR"),
        (["Knie rechts außen", "Knie links außen", "Knie rechts innen"], "Knie rechts außen"),
        (["Genou_Latéral_droit", "Genou_Latéral_gauche"], "Genou_Latéral_droit"),
        (["rodilla_externa_derecha", "rodilla_externa_izquierda"], "rodilla_externa_derecha"),
    ],
)  # fmt: skip
def test_a_label_is_told_by_its_words_in_any_order_and_language(labels, knee):
    labels = [*labels, *both("@_SIAS @SIPS Lat.Ankle.@")]
    found = marker_sets.guess(labels).found_in(labels)
    assert found["epicondyle_lateral_r"] == (knee,)
    assert found["asis_l"] == ("L_SIAS",)
    assert found["malleolus_lateral_l"] == ("Lat.Ankle.L",)


@pytest.mark.parametrize(
    ("inner", "outer"),
    [("Knöchel_@_innen", "Knöchel_@_außen"), ("Knoechel @ innen", "aussen Knoechel @"),
     ("Malléole int @", "Malléole ext @"), ("malleolo_interno_@", "malleolo_esterno_@")],
)  # fmt: skip
def test_both_sides_of_an_ankle_are_told_in_other_languages(inner, outer):
    labels = [*both("@ASI @PSI @KNE"), *(w.replace("@", s) for w in (inner, outer) for s in "RL")]
    found = marker_sets.guess(labels).found_in(labels)
    assert found["malleolus_medial_r"] == (inner.replace("@", "R"),)
    assert found["malleolus_lateral_l"] == (outer.replace("@", "L"),)


@pytest.mark.parametrize("knee", ["@KNE", "@_Knee"])
@pytest.mark.parametrize("elbow", ["@.Epi.{}", "@_{}_Epi", "@_Epicondyle_{}", "Epi{}@"])
def test_epicondyles_beside_a_knee_are_those_of_the_elbow(knee, elbow):
    arm = " ".join(elbow.format(side) for side in ("Lat", "Med"))
    labels = ["S2", *both(f"@.ASIS @ANK {knee} {arm} @.Wrist.Lat")]
    found = marker_sets.guess(labels).found_in(labels)
    assert found["epicondyle_lateral_r"] == (knee.replace("@", "R"),)
    assert "epicondyle_medial_r" not in found


def test_epicondyles_alone_make_no_knee_by_their_words_unless_they_say_of_which_bone():
    labels = both("@ASI @PSI @ANK @.Epi.Lat")
    with pytest.raises(LegsimError, match="no marker for epicondyle_lateral_r"):
        marker_sets.guess(labels)
    labels = both("@ASI @PSI @ANK @.Fem.Epi.Lat")
    assert marker_sets.guess(labels).found_in(labels)["epicondyle_lateral_l"] == ("L.Fem.Epi.Lat",)


def test_a_number_stays_with_the_word_before_it():
    seven = [*both("@ASI @PSI @_Knee_Outer @ANK")]
    arm = both("SH1_@ TH1_@ 1_@_SH")
    found = marker_sets.guess([*seven, *arm]).found_in([*seven, *arm])
    assert not [role for role in found if role.startswith(("thigh", "shank"))]
    leg = both("@_SH_1 @.TH.1")
    found = marker_sets.guess([*seven, *leg]).found_in([*seven, *leg])
    assert (found["shank_1_r"], found["thigh_1_l"]) == (("R_SH_1",), ("L.TH.1",))


def test_words_that_leave_the_side_of_the_body_open_are_not_guessed():
    labels = [*both("@ASI @PSI @_ankle_lat"), "knee_lateral", "lateral_knee_2"]
    with pytest.raises(LegsimError, match="no marker for epicondyle_lateral_r"):
        marker_sets.guess(labels)


MOTIVE = both("Waist@Front Waist@Back @Thigh @KneeOut @Shin @AnkleOut @ToeOut @Heel")


@pytest.mark.parametrize("prefix", ["", "Skeleton 001:", "Skeleton_001_"])
def test_the_baseline_skeleton_of_motive_is_known_with_any_prefix(prefix):
    labels = [prefix + name for name in MOTIVE]
    guessed = marker_sets.guess(labels)
    found = guessed.found_in(labels)
    assert guessed.name == "motive_baseline"
    assert found["sacrum"] == (prefix + "WaistRBack", prefix + "WaistLBack")
    assert found["epicondyle_lateral_l"] == (prefix + "LKneeOut",)
    assert found["meta5_r"] == (prefix + "RToeOut",)
    assert "psis_r" not in found


def test_the_landmarks_of_mvn_are_known_and_its_joints_are_none():
    labels = [
        "pSacrum", "pHipOrigin", "jL5S1",
        *(f"{name.replace('@', s)}" for s in ("Right", "Left")
          for name in ("p@ASI", "p@KneeLatEpicondyle", "p@LatMalleolus", "p@TopOfFoot", "j@Knee")),
    ]  # fmt: skip
    guessed = marker_sets.guess(labels)
    assert guessed.name == "xsens_mvn"
    assert guessed.found_in(labels)["epicondyle_lateral_r"] == ("pRightKneeLatEpicondyle",)
    joints = [f"j{s}{name}" for s in ("Right", "Left") for name in ("Hip", "Knee", "Ankle")]
    with pytest.raises(
        LegsimError, match=r"joint centers of a pose .*no landmarks; .*joint angles \(\.mot\)"
    ):
        marker_sets.guess(joints)


@pytest.mark.parametrize(
    "labels",
    [
        [*both("@Hip @Knee @Ankle @BigToe @Heel"), "Neck", "CHip"],
        [f"{s}_{name}" for s in ("left", "right") for name in ("hip", "knee", "ankle")],
        [f"{s}{name}" for s in ("left", "right") for name in ("Hip", "Knee", "Ankle", "FootIndex")],
        [f"{name}_{s}" for s in "LR" for name in ("HJC", "Hip", "Knee", "Ankle")],
    ],
)
def test_joint_centers_of_a_pose_estimator_are_no_markers_and_what_lacks_is_named(labels):
    with pytest.raises(
        LegsimError,
        match=r"finds no marker for sacrum, asis_r, asis_l among .*joint centers of a pose .*no landmarks",
    ):
        marker_sets.guess(labels)


def test_a_thigh_marker_called_hip_makes_no_joint_center_of_a_knee():
    labels = [*both("@ASI @Hip @Knee @Ankle")]
    with pytest.raises(LegsimError, match=r"no marker for sacrum among .*give a marker map"):
        marker_sets.guess(labels)


def test_two_people_are_reported():
    labels = [
        f"{person}:{label}"
        for person in ("Ann", "Bob")
        for label in ("SACR", *both("@ASI @KNE @ANK"))
    ]
    with pytest.raises(
        LegsimError,
        match=r"tell of 2 people \(Ann, Bob\): export one of them, or .* sacrum = 'Ann:SACR'",
    ):
        marker_sets.guess(labels)


@pytest.mark.parametrize("spoil", ["half of one", "one without a prefix"])
def test_a_second_person_is_reported_who_is_not_whole_or_has_no_prefix(spoil):
    whole = ["SACR", *both("@ASI @KNE @ANK")]
    first = whole if spoil == "one without a prefix" else [f"Ann:{name}" for name in whole]
    second = [f"Bob:{name}" for name in whole if name != "LKNE"]
    with pytest.raises(LegsimError, match=r"tell of 2 people \((Ann|without a prefix), Bob\)"):
        marker_sets.guess([*first, *second])


def test_parts_of_one_person_under_prefixes_of_their_own_are_no_people():
    labels = ["pelvis:SACR", *both("pelvis:@ASI leg:@KNE leg:@ANK")]
    assert marker_sets.guess(labels).missing_in(labels) == ()


def test_labels_that_are_there_twice_are_named_where_a_role_lacks_one():
    labels = ["SACR", *both("@ASI @ANK"), "LKNE", "RKNE#1", "RKNE#2"]
    with pytest.raises(LegsimError, match=r"several markers are called RKNE: none is taken"):
        marker_sets.guess(labels)


def test_an_own_map_is_read(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('[roles]\nsacrum = ["A", "B"]\nasis_r = "C"\nasis_l = [["D"], ["E", "F"]]\n')
    own = marker_sets.load(path)
    assert own.name == "mine"
    assert own.roles == ("sacrum", "asis_r", "asis_l")
    assert own.alternatives == ((("A", "B"),), (("C",),), (("D",), ("E", "F")))


@pytest.mark.parametrize(("content", "message"), [
    ("roles = 3", r"does not hold the one table \[roles\]"),
    ("[roles]\nsacrum = 3", r"role sacrum is given 3; give a label, a list of labels"),
    ("[roles]\nsacrum = []", r"role sacrum is given \[\]"),
    ('[roles]\nsacrum = [["A"], "B"]', "role sacrum is given"),
    ('[roles]\nsacrum = ""', "role sacrum is given ''"),
    ('[roles]\nsacrumm = "A"', r"no role is named 'sacrumm'.*correct the name of the role"),
    ('[roles]\nsacrum = "A"\n[more]\na = 1', r"does not hold the one table"),
    ("[roles", "is not TOML"),
    (b"\xff\xfe", "is not TOML"),
])  # fmt: skip
def test_a_map_that_is_none_is_refused(tmp_path, content, message):
    path = tmp_path / "mine.toml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(LegsimError, match=message):
        marker_sets.load(path)


def test_an_unknown_set_and_a_missing_file_are_refused(tmp_path):
    with pytest.raises(
        LegsimError,
        match=r"no marker set is named helen; there are: bts_davis, .*, or give a TOML file",
    ):
        marker_sets.load("helen")
    with pytest.raises(LegsimError, match="no such file"):
        marker_sets.load(tmp_path / "none.toml")


def test_the_map_in_the_documents_covers_what_is_needed(tmp_path):
    page = (Path(__file__).parents[2] / "docs/formats.md").read_text()
    (text,) = re.findall(r"```toml\n(.*?)```", page, re.S)
    (tmp_path / "mine.toml").write_text(text)
    mine = marker_sets.load(str(tmp_path / "mine.toml"))
    labels = [label for alternatives in mine.alternatives for label in alternatives[-1]]
    assert not mine.missing_in(labels)
    assert mine.found_in(labels)["sacrum"] == ("PSIS right", "PSIS left")
