"""The summary of the paper's scan, of corrected and tilted ones, and of what a phantom loses."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from legsim.core import transforms
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.phantom.meshes import Part, Phantom
from legsim.scan.coverage import summarize


def paper(views: int = 248, **options) -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=np.arange(views) / 31.0,
        angles=np.deg2rad(0.8 * np.arange(views)),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(480, 620),
        pixel_pitch=0.616e-3,
        **options,
    )


def test_the_papers_scan():
    found = summarize(paper(isocenter=(0.1, 0.5, -0.02)))
    np.testing.assert_allclose(found.isocenter, (0.1, 0.5, -0.02), atol=1e-9)
    np.testing.assert_allclose(found.axis, (0, 1, 0), atol=1e-9)
    assert np.rad2deg(found.angular_range) == pytest.approx(247 * 0.8)
    assert np.rad2deg(found.largest_step) == pytest.approx(0.8)
    assert np.rad2deg(found.fan_angle) == pytest.approx(
        np.rad2deg(2 * np.arctan(310 * 0.616 / 1198))
    )
    assert found.magnification == pytest.approx((1198 / 780, 1198 / 780))
    assert found.width == pytest.approx(620 * 0.616e-3 * 780 / 1198)
    assert found.height == pytest.approx(480 * 0.616e-3 * 780 / 1198)
    assert found.field_radius == pytest.approx(0.78 * np.sin(np.arctan(310 * 0.616 / 1198)))
    assert "complete: a fan of 18.11 deg needs 198.11 deg" in found.lines()[5]
    assert summarize(paper(100)).lines()[5].split()[2] == "incomplete:"


def test_a_tilted_scanner_turns_about_a_tilted_axis():
    tilt = transforms.rigid(transforms.axis_rotation((1, 0, 0), 0.3), np.zeros(3))
    found = summarize(paper().moved(transforms.inverse(tilt)))
    np.testing.assert_allclose(found.axis, (0, np.cos(0.3), np.sin(0.3)), atol=1e-9)
    assert np.rad2deg(found.angular_range) == pytest.approx(247 * 0.8)


def test_a_full_turn_and_single_views():
    assert np.rad2deg(summarize(paper(500)).angular_range) == pytest.approx(499 * 0.8)
    for views in (1, 2):
        assert np.rad2deg(summarize(paper(views)).angular_range) == pytest.approx(0.8 * (views - 1))
        assert len(summarize(paper(views)).lines()) == 11


def test_what_is_cut_off_is_said_side_by_side():
    def box(name, low, high):
        mesh = trimesh.creation.box(bounds=[low, high])
        return Part(name, "water", 1.0, mesh.vertices, mesh.faces)

    inside = box("inside", (-0.05, -0.05, -0.05), (0.05, 0.05, 0.05))
    tall = box("tall", (-0.001, -0.02, -0.001), (0.001, 0.2, 0.001))
    aside = box("aside", (0.1, 0, -0.001), (0.15, 0.01, 0.001))
    found = summarize(paper(1), Phantom((inside, tall, aside)))
    assert [part.name for part in found.cut_off] == ["tall", "aside"]
    above, right = found.cut_off
    assert above.above == pytest.approx(0.2 - 240 * 0.616e-3 * 780 / 1198, abs=5e-4)
    assert (above.left, above.right, above.below) == (0, 0, 0)
    assert right.right == pytest.approx(0.15 - 310 * 0.616e-3 * 780 / 1198, abs=5e-4)
    assert found.lines()[-2].startswith("cut off            part 'tall' in 1 of 1 views: ")
    assert found.lines()[-1].endswith("mm right (at the isocenter)")


def test_a_detector_to_one_side_says_what_either_side_reaches():
    whole = ConeBeamGeometry.circular(
        times=np.arange(60) / 30,
        angles=np.radians(np.arange(60) * 6.0),
        source_isocenter=0.8,
        source_detector=1.2,
        shape_vu=(10, 100),
        pixel_pitch=3e-3,
    )
    aside = ConeBeamGeometry(
        whole.times,
        np.array([[1.0, 0, -25], [0, 1, 0], [0, 0, 1]]) @ whole.matrices,
        (10, 100),
        3e-3,
    )
    radii = [0.8 * np.sin(np.arctan(n * 3e-3 / 1.2)) for n in (25, 75)]
    summary = summarize(aside)
    assert (summary.field_radius, summary.far_side) == pytest.approx(radii)
    assert any("half fan " in line for line in summary.lines())
    odd = np.where(np.arange(60)[:, None, None] == 7, whole.matrices, aside.matrices)
    reached = 0.8 * np.sin(np.arctan(50 * 3e-3 / 1.2))  # by one view of another offset
    assert summarize(replace(aside, matrices=odd)).far_side == pytest.approx(reached)
    assert not any("half fan " in line for line in summarize(whole).lines())


def test_the_order_of_views_does_not_change_the_range(rng: np.random.Generator):
    angles = np.radians(np.arange(0, 210, 2.0))
    scans = [
        ConeBeamGeometry.circular(
            times=np.arange(len(a)),
            angles=a,
            source_isocenter=0.78,
            source_detector=1.198,
            shape_vu=(48, 62),
            pixel_pitch=6e-3,
        )
        for a in (angles, rng.permutation(angles), angles[::-1])
    ]
    for geometry in scans:
        summary = summarize(geometry)
        assert np.degrees(summary.angular_range) == pytest.approx(208)
        assert np.degrees(summary.largest_step) == pytest.approx(2)


def test_what_lies_behind_the_source_is_not_cut_off():
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=0.015)
    geometry = paper(views=3)
    behind = Part("behind", "water", 20.0, sphere.vertices + np.array([0.2, 0, 1.5]), sphere.faces)
    assert summarize(geometry, Phantom((behind,))).cut_off == ()
    # from the isocenter to beyond the sources: only what images show counts
    long = Part("long", "water", 20.0, sphere.vertices * (1, 1, 100), sphere.faces)
    for part in summarize(geometry, Phantom((long,))).cut_off:
        assert max(part.left, part.right, part.below, part.above) < 0.5
