"""A measured scan as files that a person assembled by hand."""

from pathlib import Path

import numpy as np

from legsim.core import transforms
from legsim.geometry import files as geometry_files
from legsim.geometry import image_files
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.imu.files import save_imu
from legsim.imu.signals import ImuSignals
from tests.examples.sensors import swaying

VIEWS = 24
RATE_HZ = 5.0
POSE = transforms.rigid(
    transforms.rotation_from_vector([np.radians(-90), 0, 0]), [0.0, -0.02, 0.02]
)
"""world_from_sensor at 0 s of a sensor whose z axis is up; there its own sway is at its middle"""

SCAN = """
projections = "projections.mha"
geometry = "geometry.xml"
view_rate_hz = 5.0

[[imu]]
file = "imu.csv"

[[imu.sensors]]
name = "shank_l"
segment = "tibia_l"

[imu.sensors.start]
position_mm = [0.0, -20.0, 20.0]
rotation_deg = [-90.0, 0.0, 0.0]

[grid]
shape_zyx = [16, 12, 16]
spacing_mm = [5.0, 5.0, 5.0]
"""


def geometry() -> ConeBeamGeometry:
    """A full turn of a small detector."""
    return ConeBeamGeometry.circular(
        times=np.arange(VIEWS) / RATE_HZ,
        angles=np.linspace(0, 2 * np.pi, VIEWS, endpoint=False),
        source_isocenter=0.7,
        source_detector=1.0,
        shape_vu=(16, 20),
        pixel_pitch=8e-3,
    )


def signals() -> ImuSignals:
    """One sensor that leans to all sides about its own origin."""
    one = swaying()
    return ImuSignals(
        one.times, ("shank_l",), one.angular_velocity[:, None], one.specific_force[:, None]
    )


def write(folder: Path, scan: str = SCAN) -> Path:
    """The files and the SCAN.toml, whose path is returned."""
    views = geometry()
    rng = np.random.default_rng(1)
    # of a body that is round about the axis, so that views agree on the rays that they share
    profile = 1 - np.linspace(-1, 1, views.shape_vu[1]) ** 2
    noise = 0.02 * rng.random((VIEWS, *views.shape_vu))
    images = (profile + noise).astype(np.float32)
    folder.mkdir(parents=True, exist_ok=True)
    image_files.save_projections(folder / "projections.mha", Projections(views, images))
    geometry_files.save_geometry(folder / "geometry.xml", views)
    save_imu(folder / "imu.csv", signals())
    (folder / "scan.toml").write_text(scan)
    return folder / "scan.toml"
