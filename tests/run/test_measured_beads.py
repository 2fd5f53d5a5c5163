"""Beads of a measured scan: whose they are, where they are tracked, and what lacks for a method."""

from dataclasses import replace

import numpy as np
import pytest

import legsim as ls
from legsim.config.measured_scan import MeasuredBeadsConfig
from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.deformation.files import load_motion
from legsim.geometry import image_files
from legsim.geometry.cone_beam import Projections
from legsim.run import measured_beads
from legsim.run.measured import load_measured_scan
from tests.correction.test_fused import PLACES, VIEWS, left_px, motion_of
from tests.run.test_measured_aids import BEADS, GEOMETRY, SWAY, bead_pixels, loaded, table, write

STILL = GEOMETRY.project(np.broadcast_to(PLACES, (len(VIEWS), 2, 3)))[0]
SCAN = """
projections = "projections.mha"
geometry = "geometry.json"
{}
[grid]
shape_zyx = [8, 6, 8]
spacing_mm = [10.0, 10.0, 10.0]
"""


def drawn(pixels: np.ndarray) -> np.ndarray:
    """Images of round shadows, 1.5 pixels in radius."""
    rows, columns = np.indices(GEOMETRY.shape_vu)
    images = np.zeros((len(VIEWS), *GEOMETRY.shape_vu), np.float32)
    for image, shadows in zip(images, pixels, strict=True):
        for u, v in shadows:
            image += np.clip(2 - np.hypot(columns - u, rows - v), 0, 1).astype(np.float32)
    return images


def test_beads_of_few_views_are_tracked_in_all(tmp_path):
    path = write(tmp_path, f"{BEADS}track = true\n", beads=table(STILL, [0, 20, 40]))
    images = Projections(GEOMETRY, drawn(STILL))
    image_files.save_projections(tmp_path / "projections.mha", images)
    made = measured_beads.of_sensor(load_measured_scan(path), "shank_l")
    assert made is not None
    np.testing.assert_allclose(made().pixels, STILL, atol=0.2)


@pytest.mark.parametrize("track", ["true", "false"])
def test_stated_errors_of_pixels_are_those_of_shadows(tmp_path, track: str):
    path = write(tmp_path, f"{BEADS}track = {track}\nerror_px = 1.7\n", beads=table(STILL))
    images = Projections(GEOMETRY, drawn(STILL))
    image_files.save_projections(tmp_path / "projections.mha", images)
    made = measured_beads.of_sensor(load_measured_scan(path), "shank_l")
    assert made is not None
    assert made().error_px == 1.7


def test_a_view_that_hides_a_bead_has_no_row(tmp_path):
    pixels = bead_pixels()
    scan = loaded(tmp_path, beads=table(pixels, list(range(5, 62))))
    made = measured_beads.of_sensor(scan, "shank_l")
    assert made is not None
    assert np.isnan(made().pixels[:5]).all()
    np.testing.assert_allclose(made().pixels[5:], pixels[5:], atol=1e-3)


def test_one_click_is_no_place(tmp_path):
    scan = loaded(
        tmp_path, more=f"{BEADS}track = true\n", beads="view,bead,u,v\n0,0,9,9\n0,1,8,8\n"
    )
    with pytest.raises(LegsimError, match=r"bead 0 is there in 1 view; give each bead in 2"):
        measured_beads.of_sensor(scan, "shank_l")


def test_beads_are_on_the_segment_of_the_sensor_that_is_named_or_followed(tmp_path):
    more = '[[beads]]\nfile = "beads.csv"\n[[beads]]\nfile = "beads.csv"\nsensor = "shank_l"\n'
    scan = loaded(tmp_path, more=more)
    both = measured_beads.of_sensor(scan, "shank_l")
    assert both is not None
    np.testing.assert_array_equal(both().pixels[:, :2], both().pixels[:, 2:])
    assert measured_beads.of_sensor(scan, "thigh_l") is None
    with pytest.raises(
        LegsimError, match=r"\(beads\): beads.csv is on the segment of 'thigh_l', wh"
    ):
        loaded(tmp_path, more=BEADS + 'sensor = "thigh_l"\n')


def test_beads_around_the_knee_are_followed_without_a_sensor(tmp_path):
    """Four beads in two files; a pose needs no less."""
    write(tmp_path)
    more = PLACES + np.array([[-0.02, -0.03, -0.05], [0.03, -0.04, 0.01]])
    around = np.concatenate([PLACES, more])
    pixels = GEOMETRY.project(motion_of(SWAY).carry(around))[0]
    for name, some in (("a.csv", pixels[:, :1]), ("b.csv", pixels[:, 1:])):
        (tmp_path / name).write_text(table(some))
    path = tmp_path / "scan.toml"
    path.write_text(SCAN.format('[[beads]]\nfile = "a.csv"\n[[beads]]\nfile = "b.csv"\n'))
    ls.correct(path, "marker-based", tmp_path / "out")
    found = load_motion(tmp_path / "out/motion-marker-based.npz")
    assert isinstance(found, ls.RigidMotion)
    before = left_px(ls.RigidMotion.identity(VIEWS), SWAY)
    assert left_px(found, SWAY) < 0.05 * before
    path.write_text(SCAN.format('[beads]\nfile = "b.csv"\n'))
    with pytest.raises(LegsimError, match=r"b.csv: view 0 shows 3 beads; marker-based needs 4 or"):
        ls.correct(path, "marker-based", tmp_path / "three")
    rows = [row for row in table(pixels).splitlines() if not row.startswith("17,2,")]
    (tmp_path / "b.csv").write_text("\n".join(rows))
    with pytest.raises(LegsimError, match=r"b.csv: view 17 shows 3 beads"):
        ls.correct(path, "marker-based", tmp_path / "hidden")
    path.write_text(SCAN.format(""))
    with pytest.raises(LegsimError, match=r"give the pixels of their shadows as \[\[beads\]\]"):
        ls.correct(path, "marker-based", tmp_path / "none")


def test_a_run_knows_its_knee_on_both_sensors_and_articulated_beads_says_what_lacks(tiny_run):
    scan = ls.load_measured_scan(tiny_run.folder / "scan.toml")
    (hip, knee, _), poses = scan.seen.joints[0], scan.seen.starts
    at = dict(zip(scan.seen.signals.sensor_names, poses, strict=True))
    on_thigh, on_shank = (
        transforms.apply(at[name].world_from_sensor, place[None])[0]
        for name, place in (
            (hip.sensor, scan.knees_on_thighs["thigh_l"]),
            (knee.sensor, knee.position_sensor),
        )
    )
    np.testing.assert_allclose(on_thigh, on_shank, atol=1e-8)

    def beads(*sensors: str):
        given = tuple(MeasuredBeadsConfig(file="x.csv", sensor=one) for one in sensors)
        return replace(scan, settings=scan.settings.model_copy(update={"beads": given}))

    assert "segment of sensor thigh_l and shank_l" in measured_beads.lacking(scan)
    assert 'sensor = "thigh_l"' in measured_beads.lacking(beads("shank_l"))
    both = beads("shank_l", "thigh_l")
    assert measured_beads.lacking(both) == ""
    without = measured_beads.lacking(replace(both, knees_on_thighs={}))
    assert "a second [[joints]] of the knee" in without
    assert measured_beads.of_leg(scan) is None
