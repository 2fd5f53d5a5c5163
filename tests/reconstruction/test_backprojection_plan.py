"""What the plan chooses, refuses and promises."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.deformation.models import FieldMotion, RigidMotion
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction import _backprojection_plan
from tests.reconstruction.test_backprojection import FINE, GRIDS, VIEWS, as_field, bending, scan


def test_the_plan_says_what_it_takes_before_it_takes_it(device: Device) -> None:
    geometry = scan()
    decided = _backprojection_plan.plan(
        geometry, VolumeGrid.cubic(2048, 5e-5, (0.0, 0.0, 0.0)), device
    )
    assert decided.slab < 2048
    assert decided.device_bytes < 2 << 30
    starved = replace(device, candidate=replace(device.candidate, memory_bytes=1000))
    with pytest.raises(LegsimError, match="9 views of 50 x 40 pixels"):
        _backprojection_plan.plan(geometry, GRIDS["inside"], starved)


def test_the_column_kernel_is_refused_where_it_would_be_wrong(device: Device) -> None:
    on_its_side = scan().moved(
        transforms.rigid(transforms.rotation_from_vector([0.6, 0.5, 0.6]), [0.0, 0.0, 0.0])
    )
    with pytest.raises(LegsimError, match="column kernel"):
        _backprojection_plan.plan(on_its_side, GRIDS["inside"], device, kernel="columns")
    assert _backprojection_plan.plan(on_its_side, GRIDS["inside"], device).kernel == "voxels"


def test_a_motion_of_another_length_is_refused(device: Device) -> None:
    with pytest.raises(LegsimError, match="5 transforms for 9 views"):
        _backprojection_plan.plan(
            scan(), GRIDS["inside"], device, motion=RigidMotion.identity(np.arange(5.0))
        )


def test_a_motion_too_wild_for_columns_is_left_to_the_other_kernel(
    device: Device, rng: np.random.Generator
) -> None:
    geometry = scan()
    wild = FieldMotion(
        geometry.times,
        VolumeGrid.cubic(9, 0.01, (0.0, 0.0, 0.0)),
        rng.normal(0, 0.01, (VIEWS, 9, 9, 9, 3)).astype(np.float32),
    )
    assert _backprojection_plan.plan(geometry, FINE, device, motion=wild).kernel == "voxels"
    assert (
        _backprojection_plan.plan(
            geometry, FINE, device, motion=as_field(bending(rng, geometry.times), 0.006)
        ).curve
        == 2
    )
