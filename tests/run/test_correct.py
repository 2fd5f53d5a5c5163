"""A measured scan is corrected without any truth; what a method lacks is named beforehand."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest

import legsim as ls
from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.geometry import image_files
from legsim.run import correct
from tests.examples import measured
from tests.examples.measured import SCAN

OWN = """
from legsim.correction import Correction

def still(scan):
    return Correction("still", scan.projections, None)
"""


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A scan corrected by the sensor and by a method of one's own."""
    folder = tmp_path_factory.mktemp("scan")
    (folder / "own.py").write_text(OWN)
    path = measured.write(folder)
    before = {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}
    result = ls.correct(path, ["rigid", f"{folder / 'own.py'}:still"], folder / "out")
    return folder, result, before


def test_every_method_leaves_its_volume_and_its_motion(done):
    folder, result, _ = done
    names = {p.name for p in (folder / "out").iterdir()}
    assert names >= {
        *(f"volume-{m}.mha" for m in ("uncorrected", "rigid", "still")),
        *("motion-rigid.npz", "motion-rigid.csv", "report.html", "recording.rrd"),
        *("manifest.json", "pictures"),
    }
    assert [row[0] for row in result.rows()] == ["uncorrected", "rigid", "still"]
    volumes = [
        image_files.load_volume(folder / f"out/volume-{m}.mha").attenuation
        for m in ("uncorrected", "still", "rigid")
    ]
    np.testing.assert_array_equal(volumes[0], volumes[1])
    assert np.abs(volumes[0] - volumes[2]).max() > 0.01 * np.abs(volumes[0]).max()


def test_inputs_stay_as_they_are(done):
    folder, _, before = done
    assert {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()} == before


def test_the_table_of_motion_holds_the_matrices_that_were_followed(done):
    folder, _, _ = done
    lines = (folder / "out/motion-rigid.csv").read_text().splitlines()
    table = np.array([[float(x) for x in line.split(",")] for line in lines[1:]])
    saved = np.load(folder / "out/motion-rigid.npz")["moved_from_reference"]
    assert lines[0].startswith("view,time_s,r11,r12")
    assert lines[0].endswith("tx_mm,ty_mm,tz_mm")
    found = transforms.rigid(table[:, 2:11].reshape(-1, 3, 3), 1e-3 * table[:, 11:])
    np.testing.assert_allclose(found, saved, atol=1e-15)


def test_a_second_run_computes_nothing(done):
    folder, result, _ = done
    stages = json.loads((folder / "out/manifest.json").read_text())["stages"]
    names = []
    again = ls.correct(
        folder / "scan.toml",
        ["rigid", f"{folder / 'own.py'}:still"],
        folder / "out",
        on_progress=lambda name, *_: names.append(name),
    )
    assert set(names) == {"reading"}
    assert again.sharpness == result.sharpness
    assert json.loads((folder / "out/manifest.json").read_text())["stages"] == stages


def test_the_report_is_of_what_is_read_now_and_its_pictures_are_there(tmp_path):
    path = measured.write(tmp_path / "scan")
    ls.correct(path, ["uncorrected"], tmp_path / "out")
    pictures = {p.name for p in (tmp_path / "out/pictures").iterdir()}
    shutil.rmtree(tmp_path / "out/pictures")
    unstarted = '[[imu.sensors]]\nname = "thigh_l"\nsegment = "femur_l"\n\n[grid]'
    path.write_text(path.read_text().replace("[grid]", unstarted))
    table = tmp_path / "scan/imu.csv"
    head, *rows = table.read_text().splitlines()
    columns = [c for c in head.split(",") if c.startswith("shank_l")]
    more = ",".join(c.replace("shank_l", "thigh_l") for c in columns)
    at = [head.split(",").index(c) for c in columns]
    wider = [",".join([row, *(row.split(",")[k] for k in at)]) for row in rows]
    table.write_text("\n".join([f"{head},{more}", *wider]) + "\n")
    ls.correct(path, ["uncorrected"], tmp_path / "out")
    assert "Sensor thigh_l has no start and was left out" in (
        tmp_path / "out/report.html"
    ).read_text("utf-8")
    assert {p.name for p in (tmp_path / "out/pictures").iterdir()} == pictures


@pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")
def test_another_start_in_the_sensors_own_toml_is_another_volume(tmp_path):
    """Whatever file a number is in: what it decides is computed anew when it changes."""
    part = SCAN[SCAN.index("[[imu.sensors]]") : SCAN.index("[grid]")].replace("imu.", "")
    path = measured.write(
        tmp_path / "scan", 'imu = ["shank.toml"]\n' + SCAN[: SCAN.index("[[imu")] + "\n[grid]"
        + SCAN.split("[grid]")[1],
    )  # fmt: skip
    volumes = []
    for turn in ("-90.0", "-80.0"):
        text = 'file = "imu.csv"\n' + part.replace("-90.0", turn)
        (tmp_path / "scan/shank.toml").write_text(text)
        ls.correct(path, ["rigid"], tmp_path / "out")
        volumes.append(image_files.load_volume(tmp_path / "out/volume-rigid.mha").attenuation)
    assert np.abs(volumes[0] - volumes[1]).max() > 0.01 * np.abs(volumes[0]).max()


def test_the_report_says_what_was_found(done):
    folder, _result, _ = done
    page = (folder / "out/report.html").read_text()
    for text in (
        "Correction of a measured scan",
        "gradient entropy",
        "shank_l",
        "motion-rigid.csv",
    ):
        assert text in page
    verified = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(folder / "out/recording.rrd")],
        check=False,
    )
    assert verified.returncode == 0


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["oracle"], "oracle follows the true motion, which only a simulated scan has"),
        (["marker-based"], "marker-based follows beads"),
        (["fused-beads"], "fused-beads follows beads"),
        (
            ["nonrigid-3d", "oracle"],
            "nonrigid-3d needs the joints on the sensors.*; oracle follows",
        ),
        (["rigid@thigh_l"], "rigid@thigh_l needs a sensor 'thigh_l' .there: shank_l.: add"),
        (["magic"], "unknown correction method 'magic'"),
        (["static"], "static"),
    ],
)
def test_a_method_that_lacks_something_says_so_before_anything_is_made(tmp_path, names, said):
    path = measured.write(tmp_path / "scan")
    with pytest.raises(LegsimError, match=said):
        ls.correct(path, names, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_sensor_without_a_start_is_what_rigid_lacks(tmp_path):
    start = SCAN[SCAN.index("[imu.sensors.start]") : SCAN.index("[grid]")]
    path = measured.write(tmp_path / "scan", SCAN.replace(start, ""))
    with pytest.raises(LegsimError, match=r"rigid needs the pose of sensor shank_l .*imu.sensors"):
        ls.correct(path, ["rigid"], tmp_path / "out")
    result = ls.correct(path, ["uncorrected"], tmp_path / "out")
    assert [one.method for one in result.sharpness] == ["uncorrected"]


def test_inputs_and_runs_are_never_written_over(tmp_path):
    path = measured.write(tmp_path)
    with pytest.raises(LegsimError, match=r"holds projections.mha, which is read"):
        ls.correct(path, ["rigid"], tmp_path)
    (tmp_path / "run").mkdir()
    (tmp_path / "run/config.toml").write_text("")
    with pytest.raises(LegsimError, match="folder of a simulated run"):
        ls.correct(path, ["rigid"], tmp_path / "run")


def test_options_of_a_command_line_are_the_same_scan(done, tmp_path):
    """The sensors with their start are a TOML of their own; volumes agree to the last bit."""
    folder, _, _ = done
    part = SCAN[SCAN.index("[[imu.sensors]]") : SCAN.index("[grid]")].replace(
        "imu.sensors", "sensors"
    )
    (folder / "shank.toml").write_text('file = "imu.csv"\n' + part)
    given = {
        "geometry": folder / "geometry.xml",
        "imu": [folder / "shank.toml"],
        "view_rate_hz": 5.0,
        "shape_zyx": (16, 12, 16),
        "spacing_mm": (5.0, 5.0, 5.0),
    }
    settings = correct.described(folder / "projections.mha", given)
    ls.correct(settings, ["rigid"], tmp_path / "out")
    same, other = (
        image_files.load_volume(where / "volume-rigid.mha").attenuation
        for where in (folder / "out", tmp_path / "out")
    )
    np.testing.assert_array_equal(same, other)


def test_what_a_command_line_cannot_mean_is_refused(tmp_path):
    with pytest.raises(LegsimError, match="has no geometry; give --geometry"):
        correct.described(tmp_path / "p.mha", {})
    with pytest.raises(LegsimError, match="already says all; --view-rate-hz is beside it"):
        correct.described(tmp_path / "scan.toml", {"view_rate_hz": 3.0})
