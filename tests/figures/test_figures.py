"""Figures draw what they are given, on the right side, with units, and the same way every time."""

import ast
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from legsim import figures
from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.deformation.models import RigidMotion
from legsim.figures import BoxGroup, ErrorLine, ErrorPanel, HeatMap
from legsim.geometry.volume import NamedVolume, Volume, VolumeGrid
from legsim.kinematics.skeleton import SegmentPoses
from legsim.scene.values import SlicePlanes, white_level
from tests.examples import scene as example_scene


@pytest.fixture(scope="module")
def scan():
    return example_scene.scan_scene()


@pytest.fixture(scope="module")
def replay(scan):
    return scan.replay


def decoded(figure: Figure) -> np.ndarray:
    with Image.open(io.BytesIO(figures.png(figure, dpi=60))) as picture:
        return np.asarray(picture.convert("RGB"))


def labels(figure: Figure) -> str:
    return " ".join(
        text for ax in figure.axes for text in (ax.get_xlabel(), ax.get_ylabel(), ax.get_title())
    )


@pytest.fixture(scope="module")
def made(scan):
    return one_of_each(scan)


def one_of_each(scan):
    replay = scan.replay
    truth = RigidMotion.from_poses(replay.poses.times, replay.poses.of("tibia_r"))
    estimates = [("none", RigidMotion.identity(truth.times))]
    groups = [
        BoxGroup("rigid", "30 deg", np.linspace(0.9, 1, 5)),
        BoxGroup("uncorrected", "30 deg", np.linspace(0.7, 0.8, 5)),
    ]
    table = HeatMap("SI units", np.array([[1.0, 10.0], [0.1, np.nan]]), ("0", "1"), ("0", "none"))
    return {
        "slices": figures.slices(scan.volumes, scan.planes),
        "overlay": figures.overlay(scan.volumes[0], scan.volumes[1:], scan.planes),
        "montage": figures.projection_montage(scan.projections, count=5),
        "angles": figures.joint_angles(replay.trajectories),
        "imu": figures.imu_curves(replay.imu),
        "sway": figures.sway(replay.joint_centers),
        "residuals": figures.marker_residuals(replay),
        "errors": figures.motion_errors(truth, estimates, replay.joint_centers.of("knee_r")[0]),
        "boxes": figures.box_plots(groups, axis_label="SSIM"),
        "noise": figures.error_lines(
            [
                ErrorPanel(
                    "both sensors",
                    "rotation (deg)",
                    1.0,
                    (ErrorLine("SI", np.arange(3.0), np.ones(3)),),
                )
            ]
        ),
        "maps": figures.heat_maps([table], row_axis="f_a", column_axis="f_g", unit="RMSE (mm)"),
        "still": figures.still(replay, 0.5),
    }


@pytest.mark.parametrize(
    ("kind", "unit"),
    [
        ("slices", "1/mm"),
        ("montage", "line integral"),
        ("angles", "deg"),
        ("imu", "m/s²"),
        ("imu", "deg/s"),
        ("sway", "mm"),
        ("residuals", "mm"),
        ("errors", "mm"),
        ("errors", "deg"),
        ("boxes", "SSIM"),
        ("maps", "RMSE (mm)"),
        ("noise", "rotation (deg)"),
    ],
)
def test_axes_carry_units(made, kind, unit):
    assert unit in labels(made[kind])


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("angles", "right left"),
        ("imu", "x y z"),
        ("residuals", "worst marker RMS of all markers"),
        ("errors", "none"),
        ("sway", "knee_l"),
    ],
)
def test_curves_are_explained_once_where_no_curve_is_hidden(made, kind, words):
    figure = made[kind]
    told = " ".join(text.get_text() for legend in figure.legends for text in legend.get_texts())
    assert words in told
    assert not any(ax.get_legend() for ax in figure.axes)


@pytest.mark.parametrize("kind", ["angles", "imu", "sway", "residuals", "errors", "still"])
def test_no_text_is_cut_off_or_hides_another(made, kind):
    figure = made[kind]
    figure.canvas.draw()
    legends = [legend.get_window_extent() for legend in figure.legends]
    for ax in figure.axes:
        numbers = (
            [text for axis in (ax.xaxis, ax.yaxis) for text in drawn_numbers(axis)]
            if ax.axison
            else []
        )
        names = [
            text
            for text in (ax.xaxis.label, ax.yaxis.label, ax.title)
            if text.get_text() and (ax.axison or text is ax.title)
        ]
        for text in (*numbers, *names):
            box = text.get_window_extent()
            assert (
                min(box.x0, box.y0, figure.bbox.width - box.x1, figure.bbox.height - box.y1) >= 0
            ), text
            assert not any(box.overlaps(other) for other in legends), text
        for name in names:
            assert not any(
                name.get_window_extent().overlaps(number.get_window_extent()) for number in numbers
            ), name


def drawn_numbers(axis):
    """Labels of the ticks within the plot."""
    low, high = sorted(axis.get_view_interval())
    ticks = [tick for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
    return [tick.label1 for tick in ticks if tick.label1.get_visible() and tick.label1.get_text()]


def test_every_figure_is_drawn_on_white(made):
    for name, figure in made.items():
        picture = decoded(figure)
        assert (picture[0, 0] == 255).all(), name
        assert picture.std() > 5, name


def test_the_same_scene_gives_the_same_bytes(replay):
    first, second = (figures.png(figures.still(replay, 0.5), dpi=60) for _ in range(2))
    assert first == second


def test_slices_put_front_above_and_the_right_side_on_the_left():
    grid = VolumeGrid((20, 20, 20), (0.01, 0.01, 0.01), (0.0, 0.5, 0.0))
    values = np.zeros(grid.shape_zyx, np.float32)
    values[15:18, :, 15:18] = 20  # in front, to the subject's right
    values[9, 15:18, 2:5] = 20  # behind, high up, in the sagittal plane
    figure = figures.slices(
        [NamedVolume("a", Volume(grid, values))],
        SlicePlanes(0.45, 0.55, -0.005),
        window_per_mm=(0, 0.02),
    )
    axial, _, sagittal = (ax.images[0] for ax in figure.axes[:3])
    row, column = np.argwhere(axial.get_array() > 0.01).mean(0)
    assert row > 12  # drawn with the origin below
    assert column < 8
    left, right, bottom, top = axial.get_extent()
    assert left > right
    assert bottom < top
    row, column = np.argwhere(sagittal.get_array() > 0.01).mean(0)
    assert row > 12
    assert column > 12  # the back on the right
    assert axial.get_clim() == sagittal.get_clim() == (0, 0.02)


def test_slices_are_in_mm_of_world(scan):
    figure = figures.slices(scan.volumes, scan.planes)
    extent = figure.axes[0].images[0].get_extent()
    center = scan.volumes[0].volume.grid.center
    np.testing.assert_allclose((extent[0] + extent[1]) / 2, 1e3 * center[2])
    np.testing.assert_allclose((extent[2] + extent[3]) / 2, 1e3 * center[0])
    np.testing.assert_allclose(extent[3] - extent[2], 200)


def test_the_grey_window_is_that_of_the_first_volume(scan):
    figure = figures.slices(scan.volumes, scan.planes)
    limits = {ax.images[0].get_clim() for ax in figure.axes[:9]}
    assert len(limits) == 1
    np.testing.assert_allclose(limits.pop(), (0.0, 1e-3 * white_level(scan.volumes[0].volume)))


def test_equal_volumes_overlay_without_red_or_green(scan):
    reference = scan.volumes[0]
    figure = figures.overlay(reference, [reference, scan.volumes[1]], scan.planes)
    same, different = figure.axes[0].images[0].get_array(), figure.axes[1].images[0].get_array()
    np.testing.assert_array_equal(same[..., 0], same[..., 1])
    assert np.abs(different[..., 0] - different[..., 1]).max() > 0.3
    assert same[..., 2].max() == 0


def test_details_of_the_overlay_lie_on_bone_and_skin(scan):
    reference = scan.volumes[0]
    figure = figures.overlay(reference, [reference], scan.planes, width_mm=30)
    _, bone, skin = figure.axes[:3]
    x, _, z = reference.volume.grid.center
    assert abs(np.mean(bone.get_xlim()) - 1e3 * z) < 10
    assert abs(np.mean(bone.get_ylim()) - 1e3 * (x + 0.015)) < 10
    assert abs(np.mean(skin.get_ylim()) - 1e3 * (x + 0.065)) < 10


def test_overlays_need_one_grid(scan):
    other = NamedVolume("other", example_scene.leg_volume(np.zeros(3), 0.0))
    with pytest.raises(LegsimError, match="'other' lies on another grid than 'motion-free'"):
        figures.overlay(scan.volumes[0], [other], scan.planes)


def test_motion_errors_are_distances_of_the_point(replay):
    times = replay.poses.times
    truth = RigidMotion.identity(times)
    turned = transforms.rigid(transforms.axis_rotation([0, 1, 0], np.deg2rad(2)), [0.0, 0.003, 0.0])
    estimate = RigidMotion(times, np.broadcast_to(turned, (len(times), 4, 4)))
    figure = figures.motion_errors(truth, [("turned", estimate)], np.zeros(3))
    distance, angle = (ax.lines[0].get_ydata() for ax in figure.axes)
    np.testing.assert_allclose(distance, 3.0)
    np.testing.assert_allclose(angle, 2.0)


def test_angles_are_in_degrees_under_opensims_names(replay):
    figure = figures.joint_angles(replay.trajectories, ["knee_angle_r", "knee_angle_l"])
    line = figure.axes[0].lines[0]
    assert line.get_label() == "knee_angle_r"
    np.testing.assert_allclose(
        line.get_ydata(), np.rad2deg(replay.trajectories.coordinate("knee_angle_r"))
    )


def test_the_still_shows_the_frame_asked_for_with_the_subjects_right_on_the_left(replay):
    figure = figures.still(replay, 0.25)
    front = figure.axes[2]
    joints = next(line for line in front.lines if line.get_label() == "joint center")
    frame = round(0.25 * 120)
    np.testing.assert_allclose(
        joints.get_xdata(), -replay.joint_centers.positions_world[frame, :, 2]
    )
    np.testing.assert_allclose(
        joints.get_ydata(), replay.joint_centers.positions_world[frame, :, 1]
    )
    assert "0.250 s" in figure.get_suptitle()


def test_the_stills_views_turn_with_the_body(replay):
    """All three pictures of somebody who faces elsewhere are the same but for the floor's lines."""
    turn = transforms.rigid(transforms.rotation_from_vector([0, np.radians(137), 0]), np.zeros(3))
    upright = np.broadcast_to(np.eye(4), (len(replay.poses.times), 1, 4, 4))
    poses = np.concatenate([upright, replay.poses.world_from_segment], 1)
    names = ("pelvis", *replay.poses.segment_names)
    ahead = replace(replay, poses=SegmentPoses(replay.poses.times, names, poses))
    turned = replace(
        ahead,
        poses=SegmentPoses(replay.poses.times, names, turn @ poses),
        joint_centers=replace(
            replay.joint_centers,
            positions_world=transforms.apply(turn, replay.joint_centers.positions_world),
        ),
    )
    drawn = [
        [
            line.get_xydata()
            for ax in figures.still(scene, 0.25).axes
            for line in ax.lines
            if line.get_label() == "joint center"
        ]
        for scene in (ahead, turned)
    ]
    np.testing.assert_allclose(drawn[0], drawn[1], atol=1e-12)


def test_all_pictures_of_a_still_have_one_scale(replay):
    figure = figures.still(replay, 0.25)
    figures.png(figure)  # lays it out
    scales = [
        np.hypot(*(ax.transData.transform((0, 1)) - ax.transData.transform((0, 0))))
        for ax in figure.axes
    ]
    np.testing.assert_allclose(scales, scales[0], rtol=1e-3)


def test_a_still_needs_only_joint_centers(replay):
    bare = replace(replay, measured=None, modelled=None, sensor_poses=None, segment_meshes=())
    assert decoded(figures.still(bare, 0.0)).std() > 2
    assert decoded(figures.marker_residuals(bare)).std() > 2


def test_heat_maps_write_their_numbers_in_one_scale():
    tables = [
        HeatMap(title, factor * np.array([[1.0, 250.0], [0.0, np.nan]]), ("a", "b"), ("0", "1"))
        for title, factor in (("SI", 1.0), ("paper", 100.0))
    ]
    figure = figures.heat_maps(tables, row_axis="f_a", column_axis="f_g", unit="mm")
    assert [t.get_text() for t in figure.axes[0].texts] == ["1", "250", "0", "–"]
    assert (
        figure.axes[0].images[0].get_clim() == figure.axes[1].images[0].get_clim() == (1.0, 25000.0)
    )
    with pytest.raises(LegsimError, match="labels for"):
        figures.heat_maps(
            [replace(tables[0], row_labels=("a",))], row_axis="", column_axis="", unit=""
        )


def test_small_numbers_of_heat_maps_fit_their_cells():
    table = HeatMap("SI", np.array([[0.0123, 0.00123, 1.5e-5]]), ("a",), ("0", "1", "2"))
    figure = figures.heat_maps([table], row_axis="", column_axis="", unit="mm")
    assert [t.get_text() for t in figure.axes[0].texts] == ["0.012", "1.2e-3", "1.5e-5"]


def test_boxes_carry_the_published_mean():
    groups = [
        BoxGroup("rigid", "30", np.array([0.9, 1.0]), 0.993),
        BoxGroup("rigid", "60", np.array([0.8, 0.9])),
    ]
    figure = figures.box_plots(groups, axis_label="SSIM")
    diamonds = [
        line.get_ydata()
        for line in figure.axes[0].lines
        if line.get_marker() == "D" and len(line.get_ydata())
    ]
    assert [d[0] for d in diamonds] == [0.993]
    legend = figure.axes[0].get_legend()
    assert [t.get_text() for t in legend.get_texts()] == ["30", "60", "published mean"]


def test_errors_fall_with_the_factor_and_cross_the_limit():
    exponents = np.arange(4.0)
    lines = (
        ErrorLine("SI", exponents, 10.0**-exponents),
        ErrorLine("paper", exponents, np.array([5.0, 1.0, 0.1, 0.0]), published=True),
    )
    panels = [
        ErrorPanel(title, axis, 1.0, lines)
        for title, axis in (("both", "translation (mm)"), ("one", "translation (mm)"))
    ]
    figure = figures.error_lines(panels)
    left, right = figure.axes[:2]
    assert left.get_yscale() == "log"
    assert left.get_ylim() == right.get_ylim()
    curve, published, limit = left.lines
    np.testing.assert_allclose(curve.get_ydata(), 10.0**-exponents)
    assert np.isnan(published.get_ydata()[3])  # zero has no place
    assert published.get_linestyle() == "None"
    assert set(limit.get_ydata()) == {1.0}
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["SI", "paper"]
    assert "1 mm" in [t.get_text() for t in left.texts]


def test_no_global_state_of_pyplot():
    for path in Path(figures.__file__).parent.glob("*.py"):
        names = [
            a.name
            for n in ast.walk(ast.parse(path.read_text()))
            if isinstance(n, ast.Import)
            for a in n.names
        ]
        modules = [
            n.module or ""
            for n in ast.walk(ast.parse(path.read_text()))
            if isinstance(n, ast.ImportFrom)
        ]
        assert not any("pyplot" in name for name in names + modules)
