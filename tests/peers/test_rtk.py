"""FDK beside RTK's, on projections and geometry files that RTK made."""

from pathlib import Path

import numpy as np
import pytest

from legsim.geometry import files, image_files
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction import fdk
from legsim.reconstruction.fdk import FdkOptions
from tests.peers.agreement import Check

pytestmark = [pytest.mark.peer, pytest.mark.filterwarnings("ignore::DeprecationWarning")]

COUNT, SPACING_MM, SIZE, PITCH_MM = 96, 2.6, (160, 150), 3.2


@pytest.fixture(scope="module")
def rtk_scan(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray, np.ndarray]:
    """(folder with projections.mha and geometry.xml, RTK's FDK, RTK's voxelized Shepp-Logan
    phantom), both (z, y, x) as RTK has them.
    """
    itk = pytest.importorskip("itk")
    if not hasattr(itk, "RTK"):
        pytest.skip("this itk has no RTK: pip install itk-rtk")
    rtk = itk.RTK
    folder = tmp_path_factory.mktemp("rtk")
    image = itk.Image[itk.F, 3]
    geometry = rtk.ThreeDCircularProjectionGeometry.New()
    for angle in np.linspace(0, 360, 240, endpoint=False):
        geometry.AddProjection(780.0, 1198.0, float(angle))
    writer = rtk.ThreeDCircularProjectionGeometryXMLFileWriter.New()
    writer.SetFilename(str(folder / "geometry.xml"))
    writer.SetObject(geometry)
    writer.WriteFile()
    stack = _constant(rtk, image, (*SIZE, 240), (PITCH_MM, PITCH_MM, 1.0))
    phantom = rtk.SheppLoganPhantomFilter[image, image].New()
    phantom.SetInput(stack.GetOutput())
    phantom.SetGeometry(geometry)
    phantom.SetPhantomScale(100.0)
    phantom.Update()
    itk.imwrite(phantom.GetOutput(), str(folder / "projections.mha"))
    empty = _constant(rtk, image, (COUNT,) * 3, (SPACING_MM,) * 3)
    back = rtk.FDKConeBeamReconstructionFilter[image].New()
    back.SetInput(0, empty.GetOutput())
    back.SetInput(1, phantom.GetOutput())
    back.SetGeometry(geometry)
    back.Update()
    drawn = rtk.DrawSheppLoganFilter[image, image].New()
    drawn.SetInput(empty.GetOutput())
    drawn.SetPhantomScale(100.0)
    drawn.Update()
    return folder, itk.array_from_image(back.GetOutput()), itk.array_from_image(drawn.GetOutput())


def _constant(rtk, image, size, spacing):
    source = rtk.ConstantImageSource[image].New()
    source.SetSize(list(size))
    source.SetSpacing(list(spacing))
    source.SetOrigin(
        [-0.5 * (n - 1) * s for n, s in zip(size[:2], spacing[:2], strict=True)]
        + [0.0 if size[2] == 240 else -0.5 * (size[2] - 1) * spacing[2]]
    )
    return source


def test_rtk_projections_give_rtks_volume(
    device: Device, rtk_scan: tuple[Path, np.ndarray, np.ndarray], agree: Check
) -> None:
    folder, theirs, drawn = rtk_scan
    header = image_files.read_header(folder / "projections.mha")
    geometry = files.load_geometry(
        folder / "geometry.xml",
        columns=header.size[0],
        rows=header.size[1],
        pixel_mm=header.spacing_mm[0],
    )
    projections = image_files.load_projections(folder / "projections.mha", geometry)
    grid = VolumeGrid.cubic(COUNT, 1e-3 * SPACING_MM, (0.0, 0.0, 0.0))
    options = FdkOptions(window="ram-lak", water_attenuation=None)
    ours = 1e-3 * fdk.fdk(projections, grid, device=device, options=options).attenuation
    x, y, z = (1e3 * axis for axis in grid.axes())
    seen = (np.hypot(x[None, None], z[:, None, None]) < 110) & (np.abs(y[None, :, None]) < 80)
    contrast = drawn[seen].max() - drawn[seen].min()
    apart = np.sqrt(np.mean((ours - theirs)[seen] ** 2)) / contrast
    agree("FDK of a head phantom, RMS by its contrast", "RTK", apart, 0.005, "1")
    errors = [np.sqrt(np.mean((v - drawn)[seen] ** 2)) for v in (ours, theirs)]
    more = errors[0] / errors[1] - 1
    agree("its error, more than", "RTK", more, 0.001, "1")
