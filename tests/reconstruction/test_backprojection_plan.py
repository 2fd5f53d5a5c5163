"""What the plan chooses, refuses and promises."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.deformation.models import FieldMotion, RigidMotion
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device
from legsim.opencl.textures import ImageLimits
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
    assert _backprojection_plan.plan(on_its_side, GRIDS["inside"], device).kernel != "columns"


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
    assert _backprojection_plan.plan(geometry, FINE, device, motion=wild).kernel != "columns"
    assert (
        _backprojection_plan.plan(
            geometry, FINE, device, motion=as_field(bending(rng, geometry.times), 0.006)
        ).curve
        == 2
    )


def test_a_bump_between_the_places_looked_at_is_left_to_the_other_kernel(device: Device) -> None:
    """3 mm within a hand's breadth of nothing: a column would cut it off."""
    geometry, nodes = scan(), VolumeGrid.cubic(41, 0.002, (0.0, 0.0, 0.0))
    away = np.linalg.norm(nodes.positions() - (0.018, 0.007, -0.012), axis=-1)
    bump = np.zeros((VIEWS, *nodes.shape_zyx, 3), np.float32)
    bump[4, ..., 0] = 0.003 * np.exp(-((away / 0.008) ** 2)).reshape(nodes.shape_zyx)
    grid = VolumeGrid.cubic(33, 0.002, (0.0, 0.0, 0.0))
    motion = FieldMotion(geometry.times, nodes, bump)
    assert _backprojection_plan.plan(geometry, grid, device, motion=motion).kernel != "columns"
    faint = FieldMotion(geometry.times, nodes, 0.02 * bump)
    assert _backprojection_plan.plan(geometry, grid, device, motion=faint).curve == 2
    # a volume beside it does not see it
    beside = VolumeGrid.cubic(9, 0.002, (-0.02, -0.02, 0.02))
    assert _backprojection_plan.plan(geometry, beside, device, motion=motion).curve == 2


@pytest.mark.parametrize("spacing", [0.004, 0.009, 0.016, 0.03])
def test_the_bend_of_a_field_bounds_what_chords_leave_out(
    rng: np.random.Generator, spacing: float
) -> None:
    geometry = scan()
    nodes = VolumeGrid.cubic(int(0.08 / spacing), spacing, (0.003, 0.001, 0.002))
    shape = (VIEWS, *nodes.shape_zyx, 3)
    motion = FieldMotion(geometry.times, nodes, rng.normal(0, 1e-4, shape).astype(np.float32))
    grid = VolumeGrid.cubic(41, 0.001, (0.0, 0.0, 0.0))
    worst = 0.0
    for _ in range(300):
        start = rng.integers(0, 33, 3)
        corners = grid.origin + 0.001 * (start + 8 * np.array(list(np.ndindex(2, 2, 2))))
        share = rng.random(3)
        weights = np.prod(np.where(list(np.ndindex(2, 2, 2)), share, 1 - share), axis=1)
        inside = weights @ corners
        chord = np.einsum("p,vpk->vk", weights, motion.carry(corners))
        off = motion.carry(inside[None]) - chord[:, None]
        seen = geometry.project(inside + off)[0] - geometry.project(inside[None])[0]
        worst = max(worst, float(np.abs(seen).max()))
    bound = _backprojection_plan._field_bend(geometry, grid, motion)
    assert worst <= bound
    assert bound < 12 * worst, "of random nodes, the worst of many places on three axes"


@pytest.fixture
def gpu(device: Device, monkeypatch: pytest.MonkeyPatch) -> Device:
    """The device as if it were a GPU whose texture units are right."""
    monkeypatch.delenv("LEGSIM_TEXTURES", raising=False)
    return replace(device, candidate=replace(device.candidate, kind="gpu"))


def test_gpus_take_textures_where_the_views_fit(
    gpu: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    # with their borders the images of 50 x 40 pixels are 66 high and 72 wide
    large = ImageLimits(72, 66, 4, 4 * 72 * 66 * 3)
    monkeypatch.setattr(Device, "image_limits", large)
    decided = _backprojection_plan.plan(scan(), GRIDS["inside"], gpu)
    assert (decided.kernel, decided.batch) == ("textures", 3)
    monkeypatch.setenv("LEGSIM_TEXTURES", "off")
    assert _backprojection_plan.plan(scan(), GRIDS["inside"], gpu).kernel == "voxels"


SMALL = {
    "narrow": (ImageLimits(71, 66, 4, 1 << 30), "50 x 40 pixels take images of 72 x 66"),
    "low": (ImageLimits(72, 65, 4, 1 << 30), "its largest are 72 x 65"),
    "little memory": (ImageLimits(72, 66, 4, 4 * 72 * 66 - 1), "a view takes"),
}


@pytest.mark.parametrize(("limits", "why"), SMALL.values(), ids=SMALL)
def test_views_beyond_the_texture_units_limits_stay_in_buffers(
    gpu: Device, monkeypatch: pytest.MonkeyPatch, limits: ImageLimits, why: str
) -> None:
    monkeypatch.setattr(Device, "image_limits", limits)
    assert _backprojection_plan.plan(scan(), GRIDS["inside"], gpu).kernel == "voxels"
    with pytest.raises(LegsimError, match=f"the kernel 'textures' does not work on .*{why}"):
        _backprojection_plan.plan(scan(), GRIDS["inside"], gpu, kernel="textures")


def test_texture_units_that_read_wrongly_are_refused_by_name(
    gpu: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Device, "texture_fault", "its texture units returned wrong numbers")
    assert _backprojection_plan.plan(scan(), GRIDS["inside"], gpu).kernel == "voxels"
    with pytest.raises(LegsimError, match=r"'textures' does not work on .*: its texture units"):
        _backprojection_plan.plan(scan(), GRIDS["inside"], gpu, kernel="textures")
