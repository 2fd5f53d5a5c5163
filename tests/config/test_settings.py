import re
from pathlib import Path

import pytest

from legsim import config
from legsim.core.errors import LegsimError


def test_dumping_and_loading_gives_the_same_tree(tmp_path):
    original = config.load_settings(
        preset="half",
        overrides=(
            "scan.start_s=2.5",
            "motion.file=my walk.trc",
            "seed=7",
            "reconstruction.window=hann",
        ),
    )
    (tmp_path / "c.toml").write_text(config.dump(original))
    assert config.load_settings(tmp_path / "c.toml") == original


def test_paper_preset_is_the_papers_scan():
    scan, grid = (
        config.load_settings(preset="paper").scan,
        config.load_settings(preset="paper").grid,
    )
    assert (scan.views, scan.increment_deg, scan.rate_hz) == (248, 0.8, 31.0)
    assert (scan.source_detector_mm, scan.source_isocenter_mm, scan.pixel_mm) == (
        1198.0,
        780.0,
        0.616,
    )
    assert (scan.columns, scan.rows, grid.voxels, grid.voxel_mm) == (620, 480, 512, 0.5)


@pytest.mark.parametrize("preset", ["demo", "half"])
def test_presets_see_the_same_field_as_the_paper(preset):
    ours, paper = config.load_settings(preset=preset), config.load_settings(preset="paper")
    assert ours.scan.columns * ours.scan.pixel_mm == pytest.approx(
        paper.scan.columns * paper.scan.pixel_mm
    )
    assert ours.grid.voxels * ours.grid.voxel_mm == pytest.approx(
        paper.grid.voxels * paper.grid.voxel_mm
    )


def test_file_beats_preset_and_override_beats_file(tmp_path):
    (tmp_path / "c.toml").write_text("[scan]\nviews = 10\nrows = 20\n")
    loaded = config.load_settings(tmp_path / "c.toml", preset="half", overrides=("scan.rows=30",))
    assert (loaded.scan.views, loaded.scan.rows, loaded.scan.columns) == (10, 30, 310)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[scan]\nview = 3\n", r"scan\.view\): unknown key; valid here: side, center, start_s"),
        (
            "[[imu.sensors]]\nname = 'a'\nsegment = 'b'\ndistance = 3\n",
            "valid here: name, segment, distance_mm",
        ),
        ("[scan]\nviews = 'many'\n", r"scan\.views\): Input should be a valid integer.*'many'"),
        ("[grid]\nvoxel_mm = -1\n", r"grid\.voxel_mm\): Input should be greater than 0"),
        (
            "[motion.tremor]\nband_hz = [12, 8]\n",
            r"motion\.tremor\.band_hz\): .*from a lower to a higher frequency",
        ),
        ("[imu]\nsensors = []\n", r"imu\.sensors\): Tuple should have at least 1 item"),
        ("[grid\n", "is not TOML.*line 1"),
    ],
)
def test_a_bad_file_is_refused_in_one_line_that_names_the_place(tmp_path, text, message):
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(LegsimError, match=message) as caught:
        config.load_settings(tmp_path / "c.toml")
    assert "\n" not in str(caught.value)
    assert "c.toml" in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"preset": "tiny"}, "choose one of paper, half, demo"),
        ({"overrides": ("scan.views",)}, "expected section.key=value"),
        ({"overrides": ("scan.speed=3",)}, "unknown key"),
        ({"overrides": ("seed=-1",)}, r"\(seed\): Input should be greater than or equal to 0"),
        ({"overrides": ('imu.sensors=[{name="",segment="tibia_l",distance_mm=1}]',)}, "name"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(LegsimError, match=message):
        config.load_settings(**arguments)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(LegsimError, match=r"nowhere\.toml: no such file"):
        config.load_settings(tmp_path / "nowhere.toml")


def test_the_detector_in_the_documents_can_be_set(tmp_path):
    page = (Path(__file__).parents[2] / "docs/projector.md").read_text()
    text = re.findall(r"```toml\n(.*?)```", page.partition("## Detector")[2], re.S)[0]
    (tmp_path / "c.toml").write_text(text)
    scan = config.load_settings(tmp_path / "c.toml").scan
    assert (scan.detector.photons, scan.spectrum.kvp, len(scan.detector.lag_times_s)) == (
        20000,
        90,
        len(scan.detector.lag_fractions),
    )


def test_sensors_that_nobody_names_sit_on_the_scanned_leg():
    right, left = config.load_settings(overrides=("scan.side=right",)), config.load_settings()
    assert [(s.name, s.segment) for s in right.imu.sensors] == [
        ("shank_r", "tibia_r"),
        ("thigh_r", "femur_r"),
    ]
    assert right.methods.sensor == "shank_r"
    assert [s.distance_mm for s in right.imu.sensors] == [s.distance_mm for s in left.imu.sensors]
    assert [s.name for s in left.imu.sensors] == ["shank_l", "thigh_l"]
    assert left.methods.sensor == "shank_l"


def test_sensors_that_are_named_stay_whichever_leg_is_scanned():
    named = (
        "scan.side=right",
        "imu.sensors=[{name='mine', segment='tibia_l', distance_mm=100}]",
    )
    assert [s.name for s in config.load_settings(overrides=named).imu.sensors] == ["mine"]
    chosen = config.load_settings(overrides=("scan.side=right", "methods.sensor=thigh_r"))
    assert chosen.methods.sensor == "thigh_r"
    assert [s.name for s in chosen.imu.sensors] == ["shank_r", "thigh_r"]


def test_the_right_side_survives_the_file_and_other_settings_beside_it(tmp_path):
    original = config.load_settings(
        overrides=("scan.side=right", "imu.rate_hz=240", "methods.start=fiducials")
    )
    assert (original.imu.rate_hz, original.methods.start) == (240, "fiducials")
    (tmp_path / "c.toml").write_text(config.dump(original))
    assert config.load_settings(tmp_path / "c.toml") == original


@pytest.mark.parametrize("text", ["imu = 3\n", "[imu]\nsensors = 3\n", "methods = 3\n"])
def test_a_section_that_is_none_is_refused_on_the_right_too(tmp_path, text):
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(LegsimError, match=r"c\.toml"):
        config.load_settings(tmp_path / "c.toml", overrides=("scan.side=right",))


@pytest.mark.parametrize("name", ["1", "007", "1e3", "true", "2024-01-01", "nan", "[a]", "x#y"])
def test_a_text_that_looks_like_another_value_is_a_text(name):
    loaded = config.load_settings(overrides=(f"motion.file={name}", f"methods.sensor={name}"))
    assert (loaded.motion.file, loaded.methods.sensor) == (name, name)


def test_numbers_stay_numbers_and_quoted_texts_lose_their_quotes():
    overrides = ("seed=1", "scan.rate_hz=15.5", 'motion.file="1"', "imu.noise.f_a=1", "x=1")
    assert [config.parse_override(o, config.RunConfig) for o in overrides] == [
        {"seed": 1},
        {"scan": {"rate_hz": 15.5}},
        {"motion": {"file": "1"}},
        {"imu": {"noise": {"f_a": 1}}},
        {"x": 1},
    ]


def test_a_path_may_be_a_text(tmp_path):
    (tmp_path / "c.toml").write_text("seed = 3")
    assert config.load_settings(str(tmp_path / "c.toml")) == config.load_settings(
        tmp_path / "c.toml"
    )
