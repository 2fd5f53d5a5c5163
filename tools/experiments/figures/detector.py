"""Draws what beam, detector and swinging soft tissue do to a scan of the left knee: a view, the
axial slice, and its change.

Usage: python -m tools.experiments.figures.detector [--out docs/images] (needs the extra "spectra";
half a minute)
"""

import argparse
import warnings
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl

from legsim import config
from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import VolumeGrid
from legsim.kinematics.skeleton import SEGMENTS
from legsim.opencl.device import Device, open_device
from legsim.phantom import leg_phantom
from legsim.phantom.leg_phantom import LegPhantom
from legsim.phantom.skinning import swing_of
from legsim.reconstruction import fdk
from legsim.run.c_arm import c_arm
from legsim.scan import detector, projector
from legsim.scan import spectrum as scan_spectrum
from legsim.scan.detector import Detector
from legsim.scan.spectrum import Spectrum

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

FOLDER = Path(__file__).parents[3] / "docs/images"
VIEW, SWING, SWING_HZ = 100, 3e-3, 1.0
LAG = ((0.0058, 0.094), (0.0041, 0.58), (0.0036, 3.1), (0.0013, 20.0))
DETECTORS = (
    ("perfect", Detector()),
    ("photons: 2000, readout 5", Detector(photons=2000, electronic_noise=5)),
    ("blur: 1.5 mm", Detector(blur_fwhm=1.5e-3)),
    ("lag: 1.5 % in four parts", Detector(lag=LAG)),
    ("scatter: 0.3 of primary", Detector(scatter_to_primary=0.3)),
)


class Scene:
    """The left leg, straight, and a scan of its knee at a quarter of the paper's pixels."""

    def __init__(self, device: Device) -> None:
        self.device, self.legs = device, leg_phantom.load_leg_phantom(swinging=True)
        self.left = [
            k for k, part in enumerate(self.legs.phantom.parts) if part.name.endswith("_l")
        ]
        self.phantom = self.legs.phantom.only(self.left)
        settings = config.load_settings(preset="demo").scan
        self.geometry: ConeBeamGeometry = c_arm(settings).geometry(
            np.arange(settings.views) / settings.rate_hz, knee(self.legs)
        )

    def swinging(self, view: int) -> list[FloatArray]:
        """Vertices when the soft tissue goes to and fro along x."""
        shift = SWING * np.sin(2 * np.pi * SWING_HZ * self.geometry.times[view])
        names = [swing_of(f"{bone}_l") for bone in ("femur", "tibia")]
        poses = np.concatenate(
            [self.legs.reference_world_from_segment, [transforms.translation([shift, 0, 0])] * 2]
        )
        vertices = self.legs.posed(poses, (*SEGMENTS, *names))
        return [vertices[k] for k in self.left]

    def slice(self, projections: Projections) -> FloatArray:
        """The axial slice (z, x) 12 mm above the knee axis, 1/m."""
        x, y, z = knee(self.legs)
        grid = VolumeGrid((180, 1, 180), (0.8e-3, 0.8e-3, 0.8e-3), (x, y + 0.012, z))
        return fdk.fdk(projections, grid, device=self.device).attenuation[:, 0].astype(float)


def knee(legs: LegPhantom) -> FloatArray:
    """(3,) m of the left knee's axis."""
    return legs.reference_world_from_segment[SEGMENTS.index("tibia_l"), :3, 3]


def columns(scene: Scene, spectrum: Spectrum) -> list[tuple[str, Projections]]:
    """(title, projections) of every effect, the perfect scan first."""
    clean = projector.project(scene.phantom, scene.geometry, scene.device)
    shown = [
        (title, detector.detect(clean, what, np.random.default_rng(1))) for title, what in DETECTORS
    ]
    hardened = projector.project_spectrum(scene.phantom, scene.geometry, scene.device, spectrum)
    watered = replace(hardened, line_integrals=spectrum.as_of_water(hardened.line_integrals))
    swung = projector.project(scene.phantom, scene.geometry, scene.device, posed=scene.swinging)
    return [
        *shown,
        ("tube of 90 kV", hardened),
        ("90 kV, water-precorrected", watered),
        ("soft tissue swings 3 mm", swung),
    ]


def main() -> None:
    """Writes detector.png."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=FOLDER)
    arguments = parser.parse_args()
    scene = Scene(open_device())
    spectrum = scan_spectrum.tube(
        kvp=90.0, anode_deg=12.0, aluminum_mm=3.0, copper_mm=0.1, response="energy"
    )
    shown = columns(scene, spectrum)
    warnings.simplefilter("ignore")  # the scan is a little short, as the paper's
    slices = [scene.slice(projections) for _, projections in shown]
    figure, frames = plt.subplots(3, len(shown), figsize=(1.75 * len(shown), 5.2))
    for (title, projections), image, column in zip(shown, slices, frames.T, strict=True):
        column[0].imshow(
            projections.line_integrals[VIEW], cmap="gray_r", origin="lower", vmin=0, vmax=5
        )
        column[0].set_title(title, fontsize=7)
        column[1].imshow(image, cmap="gray", origin="lower", vmin=0, vmax=60)
        change = float(np.sqrt(np.mean((image - slices[0]) ** 2)))
        reach = 3 * max(change, 1e-3)
        column[2].imshow(image - slices[0], cmap="RdBu_r", origin="lower", vmin=-reach, vmax=reach)
        column[2].set_title(f"change: RMS {change:.2f}, ±{reach:.1f} / m", fontsize=7)
        for frame in column:
            frame.axis("off")
    figure.tight_layout(pad=0.3)
    arguments.out.mkdir(parents=True, exist_ok=True)
    figure.savefig(arguments.out / "detector.png", dpi=70)


if __name__ == "__main__":
    main()
