"""A measured scan is read from files of any make, and what it lacks is named."""

import re
from dataclasses import replace

import numpy as np
import pytest

import legsim as ls
from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction.fiducials import FIDUCIAL_NAMES, Fiducials, project_fiducials
from legsim.geometry.volume import VolumeGrid
from legsim.imu.files import save_imu
from legsim.imu.gap_cost import gap_cost
from legsim.imu.signals import ImuSignals
from legsim.reconstruction import field_of_view
from tests.examples import measured
from tests.examples.measured import POSE, SCAN

START = SCAN[SCAN.index("[imu.sensors.start]") : SCAN.index("[grid]")]
JOINTS = """
[[joints]]
name = "knee_l"
sensor = "shank_l"
position_mm = [1.0, 2.0, 3.0]

[[joints]]
name = "hip_l"
sensor = "shank_l"
position_mm = [0.0, 400.0, 0.0]

[[joints]]
name = "ankle_l"
sensor = "shank_l"
position_mm = [0.0, -300.0, 0.0]

[grid]"""


def test_a_scan_is_read_in_si(tmp_path):
    scan = ls.load_measured_scan(measured.write(tmp_path))
    np.testing.assert_allclose(scan.seen.times, measured.geometry().times, atol=1e-12)
    ours, read = measured.geometry(), scan.seen.projections.geometry
    points = 0.03 * np.eye(3)
    np.testing.assert_allclose(read.project(points)[0], ours.project(points)[0], atol=1e-6)
    np.testing.assert_array_equal(
        scan.seen.signals.specific_force, measured.signals().specific_force
    )
    np.testing.assert_allclose(scan.seen.starts[0].world_from_sensor, POSE, atol=1e-12)
    assert scan.grid == VolumeGrid((16, 12, 16), (5e-3,) * 3, tuple(read.rotation_center()))
    assert scan.segments == {"shank_l": "tibia_l"}
    assert [p.name for p in scan.inputs] == [
        "projections.mha", "geometry.xml", "imu.csv", "scan.toml"
    ]  # fmt: skip


def test_the_field_of_view_is_the_grid_where_none_is_given(tmp_path):
    scan = ls.load_measured_scan(measured.write(tmp_path, SCAN[: SCAN.index("[grid]")]))
    assert scan.grid == field_of_view.grid_of(scan.seen.projections.geometry)
    assert any("Grid: the field of view" in note for note in scan.notes)
    coarse = SCAN.replace("shape_zyx = [16, 12, 16]\n", "")
    scan = ls.load_measured_scan(measured.write(tmp_path, coarse))
    assert scan.grid.spacing_xyz == (5e-3,) * 3


def test_a_clocks_offset_is_taken_off(tmp_path):
    text = SCAN.replace('file = "imu.csv"', 'file = "imu.csv"\nclock_offset_s = -0.25')
    text = text.replace("view_rate_hz = 5.0", 'view_times = "times.txt"')
    (tmp_path / "times.txt").write_text(
        "time_s\n" + "\n".join(str(1 + k / 5) for k in range(measured.VIEWS))
    )
    scan = ls.load_measured_scan(measured.write(tmp_path, text))
    assert scan.seen.times[0] == 1.0
    np.testing.assert_allclose(scan.seen.signals.times[0], 0.25)
    said = scan.notes[-1]
    assert "its clock is taken to read -0.25 s more than the views' (clock_offset_s)" in said
    assert "it recorded 0.75 s before" in said


def test_the_cost_of_a_wrong_clock_is_that_of_shifted_signals(tmp_path):
    """What the note states for 10 ms is by how much a shifted recording moves the sensor."""
    paths, stated = [], []
    for offset in (0.0, 0.01):
        text = SCAN.replace('file = "imu.csv"', f'file = "imu.csv"\nclock_offset_s = {offset}')
        scan = ls.load_measured_scan(measured.write(tmp_path, text))
        motion = ls.Rigid("shank_l")(scan.seen).motion
        assert motion is not None
        center = scan.seen.projections.geometry.rotation_center()
        paths.append(motion.carry(center[None])[:, 0])
        stated += re.findall(r"followed, by up to ([\d.e+-]+) mm", scan.notes[-1])
    off = 1e3 * np.linalg.norm(paths[1] - paths[0], axis=-1).max()
    # two digits are stated
    assert float(stated[0]) == pytest.approx(off, rel=0.06)
    assert off > 0.05


@pytest.mark.parametrize(
    ("scheme", "bridge"), [("accurate", "by a cubic, or less"), ("paper", "by straight lines")]
)
def test_what_a_gap_costs_is_noted(tmp_path, scheme, bridge):
    path = measured.write(tmp_path, f'{SCAN}\n[methods]\nscheme = "{scheme}"\n')
    whole = measured.signals()
    kept = (whole.times <= 2.0) | (whole.times >= 2.3)
    recorded = ImuSignals(
        whole.times[kept],
        whole.sensor_names,
        whole.angular_velocity[kept],
        whole.specific_force[kept],
    )
    save_imu(tmp_path / "imu.csv", recorded)
    scan = ls.load_measured_scan(path)
    assert any("(assumed: clock_offset_s is not given)" in n for n in scan.notes)
    (note,) = [n for n in scan.notes if "bridged" in n]
    assert note.startswith(f"Sensor shank_l: gaps of up to 300 ms are bridged {bridge}")
    stated = float(note.split(" mm RMS")[0].split()[-1])
    samples, views = scan.seen.signals.samples("shank_l"), scan.seen.times
    cost = gap_cost(samples, scan.seen.starts[0], views, 0.3, scheme)
    assert stated == pytest.approx(1e3 * cost, rel=5e-3)


def test_fiducials_give_the_start(tmp_path):
    """Pixels of a sensor that rests say its pose, to rounding."""
    views, rows = measured.geometry(), ["view,point,u,v"]
    for k in range(3):
        pixels = project_fiducials(views, k, POSE, Fiducials(0.02))
        rows += [
            f"{k},{name},{u!r},{v!r}"
            for name, (u, v) in zip(FIDUCIAL_NAMES, pixels.tolist(), strict=True)
        ]
    text = SCAN.replace(
        START, '[imu.sensors.start]\nfiducials = "points.csv"\naxis_length_mm = 20.0\n'
    )
    path = measured.write(tmp_path, text)
    (tmp_path / "points.csv").write_text("\n".join(rows) + "\n")
    scan = ls.load_measured_scan(path)
    found = scan.seen.starts[0].world_from_sensor
    assert np.degrees(transforms.rotation_angle(found[:3, :3].T @ POSE[:3, :3])) < 1e-4
    assert "a detection error of 1 px" in scan.notes[0]
    (tmp_path / "points.csv").write_text("\n".join(rows[:-1]) + "\n")
    # those of the first views that show all points
    assert "by 3 views" in scan.notes[0]
    assert "by 2 views" in ls.load_measured_scan(path).notes[0]


def test_a_rough_start_is_leveled_by_gravity(tmp_path):
    text = SCAN.replace("rotation_deg = [-90.0", 'known = "roughly"\nrotation_deg = [-70.0')
    scan = ls.load_measured_scan(measured.write(tmp_path, text))
    up = scan.seen.starts[0].world_from_sensor[1, :3]
    # the sway's own trend over 4.6 s is taken for tilt: 0.1 rad of lean at 0.3 and 0.5 Hz
    assert np.degrees(np.arccos(min(up @ POSE[1, :3], 1))) < 6
    assert "stays in place over the scan: turned by" in scan.notes[0]


def doubts(folder, scan: str) -> list[str]:
    return [
        note
        for note in ls.load_measured_scan(measured.write(folder, scan)).notes
        if note.startswith("In doubt: ") and "sensor" in note
    ]


ROUGH = SCAN.replace("[imu.sensors.start]", '[imu.sensors.start]\nknown = "roughly"')


@pytest.mark.parametrize("scan", [SCAN, ROUGH])
def test_a_start_that_may_be_is_not_doubted(tmp_path, scan):
    assert doubts(tmp_path, scan) == []


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[0.0, -20.0, 20.0]", "[0.0, -0.02, 0.02]", "these look like meters"),
        ("[0.0, -20.0, 20.0]", "[0.0, -20.0, 20000.0]", "farther than any of a scanned leg"),
        ("[-90.0, 0.0, 0.0]", "[-1.57, 0.0, 0.0]", "gravity in sensor shank_l is 8"),
        ("[-90.0, 0.0, 0.0]", "[90.0, 0.0, 0.0]", "gravity in sensor shank_l is 1"),
    ],
    ids=["meters", "far", "radians", "upside down"],
)
@pytest.mark.parametrize("scan", [SCAN, ROUGH])
def test_a_start_in_another_unit_or_sense_is_doubted(tmp_path, scan, old, new, said):
    (line,) = doubts(tmp_path, scan.replace(old, new))
    assert said in line


@pytest.mark.parametrize("scan", [SCAN, ROUGH])
def test_gravity_that_reads_downwards_is_doubted(tmp_path, scan):
    """As phones have it; no sensor's file by itself says so."""
    path, read = measured.write(tmp_path, scan), measured.signals()
    save_imu(tmp_path / "imu.csv", replace(read, specific_force=-read.specific_force))
    said = [note for note in ls.load_measured_scan(path).notes if "In doubt: gravity" in note]
    assert len(said) == 1
    assert "gravity in sensor shank_l is 1" in said[0]


def test_joints_are_followed_in_the_order_of_a_leg(tmp_path):
    scan = ls.load_measured_scan(measured.write(tmp_path, SCAN.replace("[grid]", JOINTS)))
    (leg,) = scan.seen.joints
    np.testing.assert_allclose(
        [p.position_sensor for p in leg], [[0, 0.4, 0], [1e-3, 2e-3, 3e-3], [0, -0.3, 0]]
    )


def test_a_sensor_without_a_start_is_left_out(tmp_path):
    scan = ls.load_measured_scan(measured.write(tmp_path, SCAN.replace(START, "")))
    assert scan.left_out == ("shank_l",)
    assert scan.seen.signals.sensor_names == ()
    assert repr(scan.seen) == "Scan(24 views, sensors , joints of 0 legs)"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("view_rate_hz = 5.0", "", "geometry.xml: does not say when its views were taken"),
        ("view_rate_hz = 5.0", "view_rate_hz = 0.5", "views are from 0 to 46 s, sensors shank_l"),
        (
            "_hz = 5.0",
            "_hz = 0.005",
            r"and end 45\d\d.* s before them; .* in ms they would be 4\.6 s",
        ),
        ('"imu.csv"', '"imu.csv"\nclock_offset_s = -1.0', r"and begin 1 s after them; give"),
        ("view_rate_hz", "view_rate", "unknown key; valid here: projections"),
        ("[grid]", "[grid]\nlike = 'x.mha'", "like already says the grid"),
        ("spacing_mm = [5.0, 5.0, 5.0]", "", "shape_zyx without spacing_mm; give both"),
        ('file = "imu.csv"', 'file = "no.csv"', "no.csv: cannot be read"),
        ("position_mm = [0.0, -20.0, 20.0]", "", "a start is a file of fiducials, or position_mm"),
        ("[grid]", JOINTS.replace("hip_l", "hip_r"), "hip_l is missing; a leg needs hip_l, knee_l"),
        ("[grid]", JOINTS.replace("hip_l", "knee_l"), "hip_l is missing; a leg needs hip_l, knee"),
        ("[grid]", JOINTS.replace("ankle_l", "knee_l"), "ankle_l is missing; a leg needs hip_l"),
        ("[grid]", JOINTS.replace('"shank_l"', '"x"', 1), "knee_l is on 'x', which has no start"),
    ],
)
def test_what_is_missing_or_wrong_is_named(tmp_path, old, new, said):
    with pytest.raises(LegsimError, match=said):
        ls.load_measured_scan(measured.write(tmp_path, SCAN.replace(old, new)))
