"""Files of sensors give what the sensors recorded, in SI."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu.files import load_imu, load_recordings, load_rest, save_imu, save_rest
from legsim.imu.recording import ImuRecording
from legsim.imu.signals import ImuSignals
from legsim.imu.tables import SensorColumns, TableLayout, load
from tests.examples.sensors import still, swaying
from tests.references.c3d import Channels, c3d_bytes

XSENS = """// Start Time: Unknown
// Update Rate: 100.0Hz
// Firmware Version: 4.3.4
PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z
"""


def xsens(path, recording, counter):
    """An export of Xsens with these packet numbers."""
    rows = np.column_stack([recording.specific_force, recording.angular_velocity]).tolist()
    lines = [f"{c:.0f},,{','.join(map(repr, row))}" for c, row in zip(counter, rows, strict=True)]
    path.write_text(XSENS + "\n".join(lines) + "\n")
    return path


def test_imu_signals_survive_the_file_to_the_last_bit(tmp_path, rng):
    signals = ImuSignals(
        np.sort(rng.random(20)),
        ("shank_l", "thigh_l"),
        rng.normal(size=(20, 2, 3)),
        rng.normal(size=(20, 2, 3)),
    )
    save_imu(tmp_path / "imu.csv", signals)
    loaded = load_imu(tmp_path / "imu.csv")
    assert loaded.sensor_names == signals.sensor_names
    for name in ("times", "angular_velocity", "specific_force"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(signals, name))


def test_imu_table_has_the_columns_that_were_promised(tmp_path):
    signals = ImuSignals(np.arange(2.0), ("s",), np.zeros((2, 1, 3)), np.ones((2, 1, 3)))
    save_imu(tmp_path / "imu.csv", signals)
    first, second, _ = (tmp_path / "imu.csv").read_text().splitlines()
    assert first == "time_s,s_ax_m_s2,s_ay_m_s2,s_az_m_s2,s_gx_rad_s,s_gy_rad_s,s_gz_rad_s"
    assert second == "0.0,1.0,1.0,1.0,0.0,0.0,0.0"


def test_an_exported_imu_csv_is_read_back_to_the_last_bit(tmp_path):
    one = still(count=50, rate_hz=120.0)
    signals = ImuSignals(
        one.times, ("a_b",), one.angular_velocity[:, None], one.specific_force[:, None]
    )
    save_imu(tmp_path / "imu.csv", signals)
    (read,) = load_recordings(tmp_path / "imu.csv")
    assert read.name == "a_b"
    np.testing.assert_array_equal(read.times, signals.times)
    np.testing.assert_array_equal(read.angular_velocity, one.angular_velocity)
    np.testing.assert_array_equal(read.specific_force, one.specific_force)


def test_lost_packets_of_a_counter_that_wraps_leave_a_gap(tmp_path):
    one = still(count=60)
    sent = np.delete(np.arange(65520, 65520 + 63), [20, 21, 22]) % 65536  # around the wrap too
    (read,) = load_recordings(xsens(tmp_path / "shank.txt", one, sent))
    assert read.name == "shank"
    np.testing.assert_allclose(read.times[[0, 19, 20, -1]], [0, 0.19, 0.23, 0.62], atol=1e-12)
    np.testing.assert_array_equal(read.specific_force, one.specific_force)
    assert "3 of 63 samples are missing, the longest gap is 40 ms at 0.190 s" in read.notes[0]


def test_an_export_with_decimal_commas_is_read(tmp_path):
    one = still(count=60)
    path = xsens(tmp_path / "shank.txt", one, np.arange(60))
    head, _, rows = path.read_text().partition("PacketCounter")
    rows = rows.replace(",", ";").replace(".", ",")
    path.write_text(head.replace("100.0Hz", "100,0Hz") + "PacketCounter" + rows)
    (read,) = load_recordings(path)
    assert read.rate_hz == pytest.approx(100)
    np.testing.assert_array_equal(read.specific_force, one.specific_force)


def test_the_real_sensors_are_read(shared_data):
    (read,) = load_recordings(shared_data / "imu/standing_shank_l.txt")
    assert len(read.times) == 1100
    assert read.rate_hz == pytest.approx(100)
    assert np.linalg.norm(read.specific_force, axis=-1).mean() == pytest.approx(9.885, abs=2e-3)
    assert read.notes == ()


@pytest.mark.parametrize(
    ("unit", "factor", "said"), [("g", 1 / 9.80665, "state its unit as g"), ("", 0.01, "gravity")]
)
def test_an_acceleration_in_another_unit_is_refused_with_the_fix(tmp_path, unit, factor, said):
    one = still(count=60)
    wrong = type(one)(one.name, one.times, one.angular_velocity, factor * one.specific_force)
    with pytest.raises(LegsimError, match=rf"shank.txt: sensor 'shank'.* not about 9.81.*{said}"):
        load_recordings(xsens(tmp_path / "shank.txt", wrong, np.arange(60)))


def test_a_stated_unit_is_converted(tmp_path):
    one = still(count=60)
    other = type(one)(
        one.name, one.times, np.degrees(one.angular_velocity), one.specific_force / 9.80665
    )
    path = xsens(tmp_path / "shank.txt", other, np.arange(60))
    (read,) = load_recordings(path, acceleration_unit="g", angular_velocity_unit="deg/s")
    np.testing.assert_allclose(read.specific_force, one.specific_force, rtol=1e-14)
    np.testing.assert_allclose(read.angular_velocity, one.angular_velocity, rtol=1e-14)


def sto(path, recording, which):
    """A table of vectors as OpenSim's readers of sensors write it."""
    values = recording.specific_force if which == "force" else recording.angular_velocity
    rows = [
        f"{t!r}\t{','.join(map(repr, row))}"
        for t, row in zip(recording.times.tolist(), values.tolist(), strict=True)
    ]
    head = "DataRate=100.0\nDataType=Vec3\nversion=3\nendheader\ntime\ttibia_l_imu\n"
    path.write_text(head + "\n".join(rows) + "\n")


def test_opensims_two_tables_of_vectors_are_one_sensor(tmp_path):
    one = still(count=40)
    sto(tmp_path / "trial_linearAccelerations.sto", one, "force")
    with pytest.raises(LegsimError, match=r"trial_angularVelocity.sto is not beside it"):
        load_recordings(tmp_path / "trial_linearAccelerations.sto")
    sto(tmp_path / "trial_angularVelocity.sto", one, "rate")
    for name in ("linearAccelerations", "angularVelocity"):
        (read,) = load_recordings(tmp_path / f"trial_{name}.sto")
        assert read.name == "tibia_l"
        np.testing.assert_array_equal(read.specific_force, one.specific_force)
        np.testing.assert_array_equal(read.angular_velocity, one.angular_velocity)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n1,2\n", "describe its columns in a small TOML"),
        ('<?xml version="1.0"?>\n<mvnx version="4"/>\n', "is MVN's XML; export"),
        ('<?xml version="1.0"?>\n<log/>\n', "is XML, not a table of text; export"),
        ("PathFileType\t4\t(X/Y/Z)\ta.trc\n", r"but a recording \(TRC\); give it as the motion"),
        ("time_s,A_x_m,A_y_m,A_z_m\n0,1,2,3\n", r"but a recording \(CSV\)"),
        ("time_s,knee_angle_r_rad,pelvis_tx_m\n0,1,2\n", r"but a recording \(CSV\)"),
        ("Trajectories\n100\n,,A\n", r"but a recording \(Nexus' CSV\)"),
        ("Format Version,1.2,x\n", r"but a recording \(Motive's CSV\)"),
        ("time_s,ax,ay,az,gx,gy,gz\n0,0,0,9.8,0,0,0\n", "describe its columns in a small TOML"),
        ("time_s,ax,ay,az,gx,gy,gz,roll_rad\n0,0,0,9.8,0,0,0,0\n", "in a small TOML"),
        ("Devices\n100\n,,IM ACC\n0,1,2\n", "describe its columns in a small TOML"),
        ("a\nendheader\ntime,ax,ay,az,gx,gy,gz\n0,0,0,9.8,0,0,0\n", "in a small TOML"),
        ("// x\nPacketCounter,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z\n1,1,1,1,1,1,1\n", "rate_hz"),
        (
            "// Update Rate: 1.2.3Hz\nPacketCounter,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z\n1,1,1,1,1,1,1\n",
            "rate_hz",
        ),
        (
            "// Update Rate: 9Hz\nPacketCounter,Acc_X,Acc_Y\n1,1,1\n",
            "without Acc_Z, Gyr_X, Gyr_Y, ",
        ),
        (
            "PacketCounter,FreeAcc_X,FreeAcc_Y,FreeAcc_Z,Gyr_X,Gyr_Y,Gyr_Z\n1,1,1,1,1,1,1\n",
            r"export of Xsens without accelerations \(Acc_X, …\); .*free accelerations lack gravity",
        ),
        (
            "// Update Rate: 9Hz\nAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z\n1\t1\t1\t1\t1\t1\n",
            r"without the packets' numbers \(PacketCounter\); export it again",
        ),
        (
            "sep=,\nDeviceTag:,DOT_01\nSampleTimeFine,Euler_X,FreeAcc_X\n1,1,1\n",
            r"export of Xsens without accelerations .*free accelerations lack gravity",
        ),
        (
            "// Update Rate: 9Hz\nPacketCounter,Acc_X,Acc_Y,Gyr_X,Gyr_Y,Gyr_Z\n1,1,1,1,1,1\n",
            "export of Xsens without Acc_Z; ",
        ),
        ("SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z\n1,1,1,1,1,1,1\n", "small TOML"),
        ('"PacketCounter","Acc_X","Acc_Y","Acc_Z","Gyr_X"\n1,1,1,1,1\n', "without Gyr_Y, Gyr_Z"),
        ("PacketCounter,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z\n1,1,1,1,1,1,1\n", "a small TOML"),
        ("PacketCounter,ax,ay,az,gx,gy,gz\n1,1,1,1,1,1,1\n", "in a small TOML"),
        ("Counter,EMG_1,EMG_2\n1,1,1\n", "is no imu.csv of legsim, .*in a small TOML"),
        ("Frame Counter,knee_angle,Roll\n1,1,1\n", "is no imu.csv of legsim, .*in a small TOML"),
        ("Counter\tGyr_X\tMat[1][1]\n1\t1\t1\n", "export of Xsens without accelerations"),
        (
            "// Update Rate:\n100\nPacketCounter,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z\n1,1,1,1,1,1,1\n",
            'has no line "Update Rate"',
        ),
        ("PacketCounter,Acc[X],Acc[Y],Acc[Z],Gyr[X]\n1,1,1,1,1\n", "in a small TOML"),
        (
            "// Update Rate: 9Hz\nPacketCounter,Acc_X,Acc_Y,Acc_Z,gyr_x,gyr_y,gyr_z\n1,1,1,1,1,1,1\n",
            "export of Xsens without Gyr_X, Gyr_Y, Gyr_Z",
        ),
    ],
)
def test_what_a_file_lacks_is_named(tmp_path, text, said):
    (tmp_path / "x.txt").write_text(text)
    with pytest.raises(LegsimError, match=said):
        load_recordings(tmp_path / "x.txt")


def test_a_table_of_orientations_is_refused(tmp_path):
    (tmp_path / "x_orientations.sto").write_text("DataType=Quaternion\nendheader\ntime\ta\n")
    with pytest.raises(LegsimError, match=r"DataType=Quaternion; give accelerations"):
        load_recordings(tmp_path / "x_orientations.sto")


def test_sensors_of_one_name_on_two_bodies_are_named_after_their_bodies(tmp_path):
    one, other = still(), swaying(seconds=1.0)
    paths = ("/bodyset/tibia_r/imu", "/bodyset/femur_r/imu")
    for which, kind in (("force", "linear_acceleration"), ("rate", "angular_velocity")):
        vectors = [
            r.specific_force if which == "force" else r.angular_velocity for r in (one, other)
        ]
        rows = [
            "\t".join([f"{t!r}", *(",".join(map(repr, v[k].tolist())) for v in vectors)])
            for k, t in enumerate(one.times.tolist())
        ]
        ending = "linearAccelerations" if which == "force" else "angularVelocity"
        text = ["DataType=Vec3", "endheader", "\t".join(["time", *(f"{p}|{kind}" for p in paths)])]
        (tmp_path / f"a_{ending}.sto").write_text("\n".join([*text, *rows]) + "\n")
    tibia, femur = load_recordings(tmp_path / "a_linearAccelerations.sto")
    assert (tibia.name, femur.name) == ("tibia_r", "femur_r")
    np.testing.assert_array_equal(tibia.specific_force, one.specific_force)
    np.testing.assert_array_equal(femur.angular_velocity, other.angular_velocity)
    doubled = (tmp_path / "a_linearAccelerations.sto").read_text().replace("femur_r", "tibia_r")
    (tmp_path / "a_linearAccelerations.sto").write_text(doubled)
    with pytest.raises(LegsimError, match=r"column names\): has two sensors called 'tibia_r'"):
        load_recordings(tmp_path / "a_linearAccelerations.sto")


def test_the_real_gyroscope_in_the_wrong_unit_is_refused(shared_data):
    path = shared_data / "imu/standing_shank_l.txt"
    with pytest.raises(LegsimError, match=r"gravity turn .* as fast .* as rad/s"):
        load_recordings(path, angular_velocity_unit="deg/s")


def test_lost_samples_and_names_with_commas_survive_the_file(tmp_path, rng):
    rate, force = rng.normal(size=(2, 5, 2, 3))
    rate[2, 0], force[2, 0] = np.nan, np.nan
    rest = rng.normal(size=(2, 3))
    signals = ImuSignals(np.arange(5.0), ("a/b, c", "ü"), rate, force, rest_force=rest)
    save_imu(tmp_path / "imu.csv", signals)
    save_rest(tmp_path / "rest.csv", signals)
    loaded = load_imu(tmp_path / "imu.csv")
    assert loaded.sensor_names == signals.sensor_names
    np.testing.assert_array_equal(loaded.specific_force, force)
    np.testing.assert_array_equal(loaded.samples("a/b, c")[0], [0, 1, 3, 4])
    np.testing.assert_array_equal(load_rest(tmp_path / "rest.csv", ("ü", "a/b, c")), rest[::-1])
    with pytest.raises(LegsimError, match="lacks a sensor"):
        load_rest(tmp_path / "rest.csv", ("other",))


@pytest.mark.parametrize("number", ["inf", "1e300", "-1e31"])
def test_signals_beyond_any_sensor_are_refused_with_their_line(tmp_path, number):
    header = "time_s,s_ax_m_s2,s_ay_m_s2,s_az_m_s2,s_gx_rad_s,s_gy_rad_s,s_gz_rad_s"
    rows = [f"{k / 100},0,9.81,0,0,0,0" for k in range(30)]
    rows[7] = f"0.07,0,9.81,{number},0,0,0"
    (tmp_path / "i.csv").write_text("\n".join([header, *rows, ""]))
    for read in (load_imu, load_recordings):
        with pytest.raises(LegsimError, match=r"i\.csv \(line 9\)"):
            read(tmp_path / "i.csv")


def test_a_table_of_vectors_without_rows_is_refused(tmp_path):
    head = "DataType=Vec3\nendheader\ntime\ta|linear_acceleration\ta|angular_velocity\n"
    (tmp_path / "a.sto").write_text(head)
    with pytest.raises(LegsimError, match="holds no row of vectors"):
        load_recordings(tmp_path / "a.sto")
    (tmp_path / "a.sto").write_text(head + "0.1\t1,2,1e300\t1,2,3\n")
    with pytest.raises(LegsimError, match=r"\(line 4\): is no row of vectors"):
        load_recordings(tmp_path / "a.sto")


def test_a_dot_of_xsens_has_degrees_per_second_and_a_counter_of_32_bits(tmp_path):
    one = still(count=60, rate_hz=60.0)
    head = ["sep=,", "DeviceTag:,D1", "FirmwareVersion:,3.0.0", "OutputRate:,60Hz", ""]
    head.append("PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z,")
    rows = [
        [70000 + k, 16667 * k, *force, *np.degrees(rate), ""]
        for k, (force, rate) in enumerate(
            zip(one.specific_force, one.angular_velocity, strict=True)
        )
    ]
    path = tmp_path / "shank.csv"
    path.write_text("\n".join(head + [",".join(map(str, row)) for row in rows]) + "\n")
    (read,) = load_recordings(path)
    np.testing.assert_allclose(read.times, one.times, atol=1e-12)
    np.testing.assert_allclose(read.angular_velocity, one.angular_velocity, rtol=1e-12)
    np.testing.assert_array_equal(read.specific_force, one.specific_force)


@pytest.mark.parametrize("tag", ["DeviceTag", "Device Tag"])
def test_an_export_with_quotes_and_units_in_its_names_is_read_in_these(tmp_path, tag):
    one = still(count=60)
    head = [f'"{tag}:","D1"', '"OutputRate:","100Hz"', '"PacketCounter","SampleTimeFine",'
            '"Acc_X (g)","Acc_Y (g)","Acc_Z (g)","Gyr_X","Gyr_Y","Gyr_Z"']  # fmt: skip
    rows = np.column_stack([one.specific_force / 9.80665, np.degrees(one.angular_velocity)])
    lines = [",".join(f'"{v!r}"' for v in (k, 0, *row)) for k, row in enumerate(rows.tolist())]
    path = tmp_path / "shank.csv"
    path.write_text("\n".join([*head, *lines]) + "\n")
    (read,) = load_recordings(path)
    np.testing.assert_allclose(read.times, one.times, atol=1e-12)
    np.testing.assert_allclose(read.angular_velocity, one.angular_velocity, rtol=1e-12)
    np.testing.assert_allclose(read.specific_force, one.specific_force, rtol=1e-12)


@pytest.mark.parametrize(
    "line",
    [
        "// Sample rate: 100.0Hz",
        "Acquisition frequency: 100 Hz",
        "// Start Time: Unknown // Sample rate: 100.0Hz // Scenario: 4.9",
        "Update Rate:,100,,",
    ],
)
def test_an_older_export_of_xsens_names_its_counter_and_rate_otherwise(tmp_path, line):
    one = still(count=60)
    path = xsens(tmp_path / "shank.txt", one, np.arange(60) + 37328)
    names = path.read_text().replace("PacketCounter", "Counter").splitlines()
    first = next(k for k, text in enumerate(names) if "Acc_X" in text)
    path.write_text("\n".join([line, *names[first:]]) + "\n")
    (read,) = load_recordings(path)
    np.testing.assert_allclose(read.times, one.times, atol=1e-12)
    np.testing.assert_allclose(read.specific_force, one.specific_force, atol=1e-5)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('{"acc": [1, 2]}', "is JSON, not a table of text"),
        ("MATLAB 5.0 MAT-file", "is MATLAB's; save its table as text"),
        ("Acceleration:\n0 1 2 3\nGyroscope:\n0 1 2 3\n", "in blocks, one below the other: split"),
    ],
)
def test_what_is_no_table_of_rows_is_named(tmp_path, content, said):
    (tmp_path / "a.txt").write_text(content)
    with pytest.raises(LegsimError, match=said):
        load_recordings(tmp_path / "a.txt")


def in_c3d(path, one: ImuRecording, labels, units) -> None:
    """Writes a recording as analog channels, in g and deg/s, beside markers of a quarter the rate."""
    both = np.concatenate([one.specific_force / 9.80665, np.degrees(one.angular_velocity)], 1)
    channels = Channels(both, labels, units, [1.0] * 6, [0] * 6, rate=one.rate_hz)
    markers = np.ones((len(one.times) // 4, 1, 3))
    path.write_bytes(c3d_bytes(markers, ["M"], rate=one.rate_hz / 4, channels=channels))


def test_channels_of_a_c3d_are_read_by_the_clock_of_its_markers(tmp_path):
    one = still(count=400, rate_hz=400)
    labels = ["EMG", "EMG", "Az", "Gyr X", "Gyr Y", "Gyr Z"]
    in_c3d(tmp_path / "a.c3d", one, labels, ["g"] * 3 + ["deg/s"] * 3)
    sensor = SensorColumns("shank", (1, 2, "Az"), ("Gyr X", "Gyr Y", "Gyr Z"))
    (found,) = load(tmp_path / "a.c3d", TableLayout((sensor,)))
    np.testing.assert_allclose(found.times, one.times, atol=1e-9)
    np.testing.assert_allclose(found.specific_force, one.specific_force, atol=1e-5)
    np.testing.assert_allclose(found.angular_velocity, one.angular_velocity, atol=1e-7)
    with pytest.raises(LegsimError, match=r"have its clock; leave rate_hz out"):
        load(tmp_path / "a.c3d", TableLayout((sensor,), rate_hz=100))
    twice = SensorColumns("shank", ("EMG", 2, "Az"), ("Gyr X", "Gyr Y", "Gyr Z"))
    with pytest.raises(LegsimError, match=r"has 2 analog channels 'EMG' .* give its number"):
        load(tmp_path / "a.c3d", TableLayout((twice,)))


def test_a_c3d_by_itself_names_its_channels(tmp_path):
    in_c3d(tmp_path / "a.c3d", still(count=40), ["a", "b", "c", "d", "e", "f"], ["V"] * 6)
    with pytest.raises(LegsimError, match=r"has 6 analog channels: a, b, c, d, e, f; name those"):
        load_recordings(tmp_path / "a.c3d")


def test_of_many_channels_few_are_listed_and_the_others_counted(tmp_path):
    """Those that sound like sensors come first."""
    one = still(count=40)
    names = [f"Force {k}" for k in range(20)] + [f"IMU{k} {q}" for k in range(9) for q in "AG"]
    names = [n.replace(" A", " ACCX").replace(" G", " GYROX") for n in names]
    channels = Channels(np.zeros((40, 38)), names, ["V"] * 38, [1.0] * 38, [0] * 38, rate=100)
    markers = np.ones((len(one.times), 1, 3))
    (tmp_path / "a.c3d").write_bytes(c3d_bytes(markers, ["M"], rate=100, channels=channels))
    with pytest.raises(LegsimError, match=r"38 analog channels: IMU0 GYROX.* and 26 others; name"):
        load_recordings(tmp_path / "a.c3d")
    asked = SensorColumns("shank", ("none", 2, 3), (4, 5, 6))
    with pytest.raises(LegsimError, match=r"0 analog channels 'none' \(of IMU0.* and 26 others\)"):
        load(tmp_path / "a.c3d", TableLayout((asked,)))


def test_the_notes_of_a_c3d_go_with_the_first_sensor(tmp_path):
    one = still(count=400, rate_hz=400)
    in_c3d(tmp_path / "a.c3d", one, ["a", "b", "c", "d", "e", "f"], ["g"] * 3 + ["deg/s"] * 3)
    data = bytearray((tmp_path / "a.c3d").read_bytes())
    data[20:24] = np.array([50], "<f4").tobytes()  # the header's rate, against POINT:RATE
    (tmp_path / "a.c3d").write_bytes(data)
    two = [SensorColumns(name, (1, 2, 3), (4, 5, 6)) for name in ("shank", "thigh")]
    shank, thigh = load(tmp_path / "a.c3d", TableLayout(tuple(two)))
    assert shank.notes == ("a.c3d: POINT:RATE says 100 Hz, the header 50 Hz; 100 Hz is taken",)
    assert thigh.notes == ()
