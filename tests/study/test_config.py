"""STUDY.toml: strict about its keys, recordings relative to the file, every shipped study plans."""

import re
from pathlib import Path

import pytest
import tomli_w

from legsim import config as legsim_config
from legsim.core.errors import LegsimError
from legsim.kinematics import from_recording
from legsim.study import config
from legsim.study import plan as study_plan

PLAIN = """
name = "mine"
title = "Mine"
preset = "demo"
subjects = ["subject01"]
postures = ["squat_30"]
methods = ["uncorrected", "rigid"]
"""


def load(tmp_path, text, **options):
    path = tmp_path / "STUDY.toml"
    path.write_text(text)
    return config.load(str(path), **options)


def test_the_papers_study_is_shipped_whole():
    asked, _ = config.load("table1")
    assert len(asked.subjects) == 7
    assert set(asked.postures) == {"squat_30", "squat_60"}


def test_preset_and_settings_can_be_laid_over(tmp_path):
    asked, base = load(
        tmp_path, PLAIN, preset="half", overrides=("scan.views=62", "imu.rate_hz=200")
    )
    settings = config.run_settings(asked, base, "subject01", "squat_30", None, None)
    assert (settings.grid.voxels, settings.scan.views, settings.imu.rate_hz) == (256, 62, 200)
    assert settings.methods.run == ("static", "uncorrected", "rigid")


def test_own_recordings_and_methods_are_found_beside_the_file(tmp_path):
    (tmp_path / "anna_stand.trc").touch()
    (tmp_path / "mine.py").touch()
    text = (
        PLAIN.replace('"subject01"', '"anna"')
        .replace('"squat_30"', '"stand"')
        .replace('"rigid"', '"mine.py:method"')
    )
    asked, base = load(tmp_path, text + 'recording = "{subject}_{posture}.trc"\n')
    settings = config.run_settings(asked, base, "anna", "stand", None, None)
    assert settings.motion.file == str(tmp_path / "anna_stand.trc")
    assert settings.methods.run[-1] == f"{tmp_path / 'mine.py'}:method"


def test_a_person_whose_name_no_file_can_have_has_no_recording_beside_the_study(tmp_path):
    name = 300 * "a"
    asked, base = load(tmp_path, PLAIN.replace("subject01", name))
    settings = config.run_settings(asked, base, name, "squat_30", None, None)
    with pytest.raises(LegsimError, match="aaa"):
        from_recording.find_recording(settings.motion.file)


def test_a_study_can_be_read_from_anywhere(tmp_path):
    home = tmp_path / "with {braces}"
    home.mkdir()
    for name in ("anna_stand.trc", "mine.py", "map.toml", "beam.csv"):
        (home / name).touch()
    text = (
        PLAIN.replace('"subject01"', '"anna"')
        .replace('"squat_30"', '"stand"')
        .replace('"rigid"', '"mine.py:method"')
    )
    text += (
        'recording = "{subject}_{posture}.trc"\n[[noise]]\nconvention = "SI"\nlevels = [[1, '
        '1]]\nmethods = ["mine.py:method"]\n'
    )
    text += (
        '[settings.motion]\nmarker_map = "map.toml"\n[settings.scan.spectrum]\nkind = '
        '"file"\nfile = "beam.csv"\n'
    )
    asked, base = load(home, text)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    again, other = load(elsewhere, tomli_w.dumps(asked.model_dump(mode="json", exclude_none=True)))
    assert again == asked
    for level in (None, *asked.noise[0].noise()):
        settings = config.run_settings(again, other, "anna", "stand", level, None)
        assert settings == config.run_settings(asked, base, "anna", "stand", level, None)
        assert settings.motion.file == str(home / "anna_stand.trc")
        assert settings.motion.marker_map == str(home / "map.toml")
        assert settings.scan.spectrum.file == str(home / "beam.csv")
        assert settings.methods.run[-1] == f"{home / 'mine.py'}:method"


@pytest.mark.parametrize("place", [p for p in legsim_config.FILES if p != ("motion", "file")])
def test_every_file_of_the_settings_is_found_beside_the_study(tmp_path, place):
    """Of two files of one name, that of the study; what is not there is a shipped one's name."""
    (tmp_path / "mine.toml").touch()
    *section, key = place
    for written, found in (("mine.toml", str(tmp_path / "mine.toml")), ("none", "none")):
        text = f'{PLAIN}[settings.{".".join(section)}]\n{key} = "{written}"\n'
        inside, _ = load(tmp_path, text)
        settings = inside.settings
        for name in section:
            settings = settings[name]
        assert settings[key] == found


def test_noise_goes_into_the_runs(tmp_path):
    asked, base = load(
        tmp_path, PLAIN + '[[noise]]\nconvention = "per-sample"\nlevels = [[5, "none"]]\n'
    )
    (level,) = asked.noise[0].noise()
    settings = config.run_settings(asked, base, "subject01", "squat_30", level, 7)
    assert (
        settings.imu.noise.kind,
        settings.imu.noise.convention,
        settings.imu.noise.f_a,
        settings.imu.noise.f_g,
    ) == (
        "paper",
        "per-sample",
        5,
        "none",
    )
    assert settings.methods.run == ("static", "rigid")
    assert settings.seed == 7


@pytest.mark.parametrize(
    ("added", "said"),
    [
        ("subject = 3", "unknown key; valid here: name, title"),
        ('[[noise]]\nconvention = "mks"\nlevels = [[1, 1]]', "noise.0.convention"),
        ('[[noise]]\nconvention = "SI"\nlevel = [[1, 1]]', "valid here: levels, convention"),
        ("[ladder]\nrepeats = 3", "valid here: subjects, postures"),
        (
            "[settings.scan]\nview = 3",
            r"STUDY.toml \[settings\] \(scan.view\): unknown key",
        ),
        (
            "[settings.methods]\nrun = ['rigid']",
            "settings.methods.run is not used .* write methods = ",
        ),
        (
            "[settings.motion]\nfile = 'a.trc'",
            "settings.motion.file is not used .* write recording = ",
        ),
        ('[[noise]]\nconvention = "SI"\nlevels = []', "noise.0.levels"),
        ('[[noise]]\nconvention = "SI"\nlevels = [["None", 1]]', "fix the value in the file$"),
        ('[[noise]]\nconvention = "SI"\nlevels = [[1, 1]]\nmethods = []', "noise.0.methods"),
        (
            '[[noise]]\nconvention = "SI"\nlevels = [[1, 1], [1.0, 1]]',
            r"f_a = 1, f_g = 1 \(SI\) twice",
        ),
        ('recording = "{person}.trc"', "recording = .*'person'.* may hold {subject} and {posture}"),
        ('recording = "{subject.trc"', "recording = .*expected '}'"),
    ],
)
def test_mistakes_are_named_with_their_place(tmp_path, added, said):
    with pytest.raises(LegsimError, match=said):
        asked, base = load(tmp_path, f"{PLAIN}\n{added}\n")
        study_plan.plan(asked, base, tmp_path)


@pytest.mark.parametrize(
    ("subjects", "postures"),
    [('["a", "a"]', '["b"]'), ('["a/b", "a_b"]', '["c"]'), ('["a-b", "a"]', '["c", "b-c"]')],
)
def test_runs_of_one_name_are_refused(tmp_path, subjects, postures):
    text = PLAIN.replace('["subject01"]', subjects).replace('["squat_30"]', postures)
    asked, base = load(tmp_path, text + 'recording = "subject01/squat_30.trc"\n')
    with pytest.raises(LegsimError, match="would be called a"):
        study_plan.plan(asked, base, tmp_path)


def test_further_recordings_are_scans_named_by_folder_and_file(tmp_path):
    (tmp_path / "anna").mkdir()
    (tmp_path / "anna" / "stand.trc").touch()
    text = PLAIN.replace("methods =", 'recordings = ["anna/stand.trc"]\nmethods =')
    asked, base = load(tmp_path, text, recordings=("/far/ben/sit.c3d",))
    assert asked.scans() == (("subject01", "squat_30"), ("anna", "stand"), ("ben", "sit"))
    files = [
        config.run_settings(asked, base, *scan, None, None).motion.file for scan in asked.scans()
    ]
    assert files[1:] == [str(tmp_path / "anna" / "stand.trc"), "/far/ben/sit.c3d"]


def test_volumes_of_sensors_need_methods(tmp_path):
    with pytest.raises(LegsimError, match=r"give both aiding.volume_sensors and aiding"):
        load(tmp_path, PLAIN + '[aiding]\nvolume_sensors = ["bmi160"]\n')


def test_a_study_that_asks_for_nothing_is_refused(tmp_path):
    with pytest.raises(LegsimError, match="asks for nothing"):
        load(tmp_path, PLAIN.replace('methods = ["uncorrected", "rigid"]', ""))


def test_noise_without_clean_methods_is_refused(tmp_path):
    text = (
        PLAIN.replace('methods = ["uncorrected", "rigid"]', "")
        + '[[noise]]\nconvention = "SI"\nlevels = [[1, 1]]\n[ladder]\n'
    )
    with pytest.raises(LegsimError, match="no clean ones"):
        load(tmp_path, text)


@pytest.mark.parametrize("name", ["table9", "no/such.toml", "."])
def test_a_study_that_is_not_there_lists_those_that_are(name):
    with pytest.raises(LegsimError, match=r"no such file; give a STUDY.toml.*table1"):
        config.load(name)


def test_the_study_in_the_documents_can_be_read(tmp_path):
    page = (Path(__file__).parents[2] / "docs/study.md").read_text()
    (text,) = re.findall(r"```toml\n(.*?)```", page, re.S)
    asked, _ = load(tmp_path, text)
    assert asked.subjects == ("anna", "ben")
    assert asked.noise[0].repetitions == 3
