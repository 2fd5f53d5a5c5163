"""A simulated scan and its truth agree with each other."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.geometry.volume import VolumeGrid
from legsim.simulation.simulated_scan import simulate_scan
from tests.examples.standing_person import c_arm, person, scan


def test_the_scan_at_rest_repeats_the_first_view():
    moving, still = (
        p.line_integrals.astype(float) for p in (scan().seen.projections, scan().at_rest)
    )
    np.testing.assert_array_equal(moving[0], still[0])
    assert np.abs(moving[-1] - still[-1]).max() > 1e-3


def test_the_true_motion_of_a_segment_carries_its_first_pose_to_every_view():
    truth = scan().truth
    poses = truth.poses.of("tibia_l")
    moved = truth.motion_of("tibia_l").moved_from_reference
    np.testing.assert_allclose(moved @ poses[0], poses, atol=1e-12)


def test_inside_a_bone_the_field_is_the_bones_motion():
    truth = scan().truth
    tibia = truth.poses.of("tibia_l")[0]
    shaft = tibia[:3, :3] @ [0.0, -0.2, 0.0] + tibia[:3, 3]
    nodes = VolumeGrid.cubic(3, 2e-3, [float(c) for c in shaft])
    center = nodes.positions()[13]
    moved = transforms.apply(truth.motion_of("tibia_l").moved_from_reference, center[None])[:, 0]
    found = center + truth.field(nodes).displacements[:, 1, 1, 1]
    np.testing.assert_allclose(found, moved, atol=2e-4)


def test_signals_without_sensors_are_refused():
    bare = replace(scan().seen.signals, sensors=())
    with pytest.raises(LegsimError, match="where their sensors are strapped on"):
        simulate_scan(person(), c_arm(), bare)
