"""`legsim run`, `replay`, `view` and `doctor` as a user meets them."""

import os
from pathlib import Path

import numpy as np
import pytest

from legsim import config
from legsim.cli import doctor
from legsim.cli import main as cli_main
from legsim.kinematics import from_recording
from legsim.mocap import trc
from legsim.mocap.trajectories import MarkerTrajectories
from legsim.run import motion as run_motion
from tests.examples import task_sets


@pytest.fixture(scope="module")
def standing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first two seconds of a held squat."""
    whole = trc.load(from_recording.find_recording("subject01/squat_30.trc"))
    path = tmp_path_factory.mktemp("recording") / "squat.trc"
    trc.save(
        path, MarkerTrajectories(whole.times[:240], whole.marker_names, whole.positions_world[:240])
    )
    return path


def refused(capsys: pytest.CaptureFixture[str], file: Path, *arguments: str) -> str:
    """The one line that `legsim replay` prints."""
    with pytest.raises(SystemExit) as caught:
        cli_main.main(["replay", str(file), "--out", str(file.parent / "out"), *arguments])
    assert caught.value.code == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.endswith("...")]
    assert len(lines) == 1
    return lines[0]


def test_a_file_without_a_needed_marker_is_one_line(standing, tmp_path, capsys):
    whole = trc.load(standing)
    kept = [k for k, name in enumerate(whole.marker_names) if name != "LKNE"]
    file = tmp_path / "lacks.trc"
    trc.save(
        file,
        MarkerTrajectories(
            whole.times, tuple(whole.marker_names[k] for k in kept), whole.positions_world[:, kept]
        ),
    )
    line = refused(capsys, file)
    assert "lacks.trc" in line
    assert "epicondyle_lateral_l" in line


def test_tasks_of_opensim_are_taken_and_what_is_none_is_one_line(standing, tmp_path, capsys):
    line = refused(capsys, standing, "--tasks", str(tmp_path / "nowhere.xml"))
    assert "nowhere.xml" in line
    line = refused(capsys, standing, "--set", "motion.ik.marker_weights.nose=2")
    assert "weight of nose: nose is no marker; give roles sacrum" in line
    line = refused(capsys, standing, "--set", 'motion.ik.locked=["knee_angle"]')
    assert "unknown coordinate 'knee_angle' for a lock; known: pelvis_tilt" in line
    line = refused(capsys, standing, "--set", "motion.zero_file=nowhere.trc")
    assert "nowhere.trc: no such motion file" in line
    tasks = tmp_path / "tasks.xml"
    markers = [task_sets.marker(name, 2) for name in trc.load(standing).marker_names]
    tasks.write_text(task_sets.document(task_sets.task_set(*markers, task_sets.marker("C7", 1))))
    with pytest.raises(SystemExit):
        cli_main.main(["replay", str(standing), "--tasks", str(tasks), "--out", str(tmp_path)])
    said = " ".join(capsys.readouterr().out.split())
    assert "tasks.xml: tasks of markers that are not on these legs: C7" in said


def test_a_wrong_unit_is_one_line_whose_cure_works(standing, tmp_path, capsys):
    whole = trc.load(standing)
    file = tmp_path / "unit.trc"
    trc.save(
        file, MarkerTrajectories(whole.times, whole.marker_names, 1000 * whole.positions_world)
    )
    assert "--set motion.unit=mm" in refused(capsys, file)
    cured = run_motion.solve(
        config.load_settings(overrides=(f"motion.file={file}", "motion.unit=mm")).motion
    )
    assert cured.fit is not None
    assert cured.fit.ik.rms < 5e-3


def test_a_given_vertical_is_believed_and_reported(standing):
    """Somebody who stands, taken as lying: gravity acts along the lab's x."""
    turned = run_motion.solve(
        config.load_settings(overrides=(f"motion.file={standing}", "motion.up=x")).motion
    )
    assert any(note.endswith("x up (as given)") for note in turned.notes)
    upright = run_motion.solve(config.load_settings(overrides=(f"motion.file={standing}",)).motion)
    np.testing.assert_allclose(
        turned.trajectories.coordinate("knee_angle_l"),
        upright.trajectories.coordinate("knee_angle_l"),
        atol=np.radians(0.5),
    )


def test_a_model_and_a_scale_file_are_options(standing, capsys):
    assert "none.osim: no such file; give an OpenSim model" in refused(
        capsys, standing, "--model", "none.osim"
    )
    assert "none.xml: no such file; give a scale file" in refused(
        capsys, standing, "--scale-file", "none.xml"
    )
    assert "none.xml: no such file; give a marker set (.xml)" in refused(
        capsys, standing, "--model", str(standing), "--marker-set", "none.xml"
    )
    assert "(settings): motion.marker_set puts markers on an OpenSim model" in refused(
        capsys, standing, "--marker-set", str(standing)
    )


@pytest.mark.end_to_end
def test_replay_prints_how_well_the_markers_are_followed(tmp_path, capsys):
    with pytest.raises(SystemExit) as caught:
        cli_main.main(["replay", "subject01/squat_30.trc", "--out", str(tmp_path)])
    assert caught.value.code == 0
    assert "mm RMS" in capsys.readouterr().out


def test_doctor_fails_where_a_finding_is_bad_and_names_the_fix(tmp_path, monkeypatch, capsys):
    findings = [doctor.Finding("disk", good=True, detail="9 GiB")]
    monkeypatch.setattr(doctor, "examine", lambda _: tuple(findings))
    for code, words in ((0, ("ok", "9 GiB")), (1, ("bad", "no display; buy one"))):
        with pytest.raises(SystemExit) as caught:
            cli_main.main(["doctor", str(tmp_path)])
        assert caught.value.code == code
        shown = capsys.readouterr().out
        assert all(word in shown for word in words)
        findings.append(doctor.Finding("viewer", good=False, detail="no display", cure="buy one"))


@pytest.mark.end_to_end
@pytest.mark.parametrize(
    "name", [b"1", b"bad\xff.trc", b"a$b_{c$ [red] x[_b].trc", b'"quoted".trc', b"{motion}.trc"]
)
def test_any_name_of_a_recording_is_replayed(standing, tmp_path, name, capsys):
    file = Path(os.fsdecode(os.fsencode(tmp_path) + b"/" + name))
    file.write_bytes(standing.read_bytes())
    if file.suffix != ".trc":
        file = file.rename(file.with_name("1.trc"))
    out = Path(os.fsdecode(os.fsencode(tmp_path) + b"/out " + name))
    with pytest.raises(SystemExit) as caught:
        cli_main.main(["replay", str(file), "--out", str(out)])
    assert caught.value.code == 0, capsys.readouterr().err
    assert (out / "report.html").is_file()
