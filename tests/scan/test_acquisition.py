import numpy as np
import pytest
import trimesh

from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.phantom import materials
from legsim.phantom.meshes import Part, Phantom
from legsim.scan import acquisition, projector
from legsim.scan.acquisition import Imaging
from legsim.scan.c_arm import CArm
from legsim.scan.detector import Detector
from legsim.scan.spectrum import Spectrum

TWO_ENERGIES = Spectrum(np.array([40.0, 80.0]), np.array([0.5, 0.5]))


def ball() -> tuple[Phantom, ConeBeamGeometry]:
    mesh = trimesh.creation.icosphere(2, radius=0.05)
    water = Part("ball", "water", materials.attenuation("water"), mesh.vertices, mesh.faces)
    small = CArm.paper(angles=np.radians([-8.8, -8.0, -7.2]), shape_vu=(32, 40), pixel_pitch=8e-3)
    return Phantom((water,)), small.geometry(np.arange(3) / 31, np.zeros(3))


def seen(how: Imaging, device, seed: int = 0) -> np.ndarray:
    return acquisition.project(*ball(), device, how, np.random.default_rng(seed)).line_integrals


def test_the_default_images_are_the_projectors_bit_for_bit(device):
    np.testing.assert_array_equal(
        seen(Imaging(), device), projector.project(*ball(), device).line_integrals
    )


def test_noise_follows_the_seed(device):
    how = Imaging(detector=Detector(photons=1e4))
    np.testing.assert_array_equal(seen(how, device), seen(how, device))
    assert (seen(how, device) != seen(how, device, seed=1)).any()


def test_water_reads_as_of_one_energy_when_it_is_precorrected(device):
    plain, corrected = (
        seen(Imaging(TWO_ENERGIES, water_precorrection=c), device) for c in (False, True)
    )
    mean = 0.5 * (materials.attenuation("water", 40.0) + materials.attenuation("water", 80.0))
    lengths = projector.project(*ball(), device).line_integrals / materials.attenuation("water")
    np.testing.assert_allclose(corrected, mean * lengths, atol=2e-5)
    assert (plain[lengths > 0.05] < 0.99 * corrected[lengths > 0.05]).all()


@pytest.mark.parametrize("rays", [2, 3])
def test_a_pixel_is_the_mean_of_its_rays_whatever_moves(device, monkeypatch, rays):
    monkeypatch.setattr(acquisition, "_VIEWS_AT_ONCE", 2)
    phantom, geometry = ball()
    moved = [
        (phantom.parts[0].vertices + np.array([0.0, 0.01 * view, 0.0]),)
        for view in range(len(geometry))
    ]
    done: list[int] = []
    averaged = acquisition.project(
        phantom,
        geometry,
        device,
        Imaging(),
        np.random.default_rng(0),
        rays_per_pixel=rays,
        posed=lambda view: moved[view],
        progress=lambda now, _: done.append(now),
    )
    fine = projector.project(
        phantom, geometry.finer(rays), device, posed=lambda view: moved[view]
    ).line_integrals
    rows, columns = geometry.shape_vu
    expected = fine.reshape(len(geometry), rows, rays, columns, rays).mean((2, 4))
    np.testing.assert_allclose(averaged.line_integrals, expected, atol=1e-6)
    assert averaged.geometry is geometry
    assert done == [2, 3]


def test_an_edge_through_a_pixel_is_seen_by_part_of_its_rays(device):
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    phantom = Phantom((Part("box", "water", 20.0, box.vertices, box.faces),))
    # the box's upper face lies in the plane of the source and of the middle of a row of pixels
    arm = CArm.paper(angles=np.radians([-8.8, -8.0]), shape_vu=(31, 40), pixel_pitch=4e-3)
    geometry = arm.geometry(np.arange(2) / 31, [0.0, 0.05, 0.0])
    one, four = (
        acquisition.project(
            phantom, geometry, device, Imaging(), np.random.default_rng(0), rays_per_pixel=rays
        ).line_integrals[0, :, 20]
        for rays in (1, 4)
    )
    inside, outside, edge = one[10], one[20], four[15]
    assert inside == pytest.approx(2.0, rel=0.02)
    assert outside == 0
    assert edge == pytest.approx(inside / 2, rel=0.05)
    assert one[15] in (pytest.approx(inside, rel=0.05), pytest.approx(0))
