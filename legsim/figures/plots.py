"""Figures of single values for a notebook: volumes, joint angles, IMU signals."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from legsim.core.errors import LegsimError
from legsim.figures import curves, pictures
from legsim.geometry.volume import NamedVolume, Volume
from legsim.imu.signals import ImuSignals
from legsim.kinematics.moving_leg import MovingLeg
from legsim.scene.slices import SlicePlanes, VolumeSlices


def plot_slices(*, window_per_mm: tuple[float, float] | None = None, **volumes: Volume) -> Figure:
    """Plots axial slices 5 cm below and above the grid's center, and the sagittal one through it.

    Args:
        window_per_mm: attenuation shown as black and as white; None takes it from the first volume.
        volumes: one column each, under its keyword.

    Raises:
        LegsimError: no volume is given.

    >>> plot_slices(truth=truth, rigid=volume).savefig("slices.png")
    """
    if not volumes:
        raise LegsimError("plot_slices needs volumes by name, as in plot_slices(truth=a, rigid=b)")
    planes = SlicePlanes.through(next(iter(volumes.values())).grid.center)
    shown = [VolumeSlices.of(NamedVolume(name, one), planes) for name, one in volumes.items()]
    return pictures.slices(shown, window_per_mm=window_per_mm)


def plot_angles(person: MovingLeg, names: Sequence[str] = ()) -> Figure:
    """Plots joint angles in degrees over time, right with left; all, or ``names`` of them."""
    known = person.trajectories.coordinate_names
    angles = [name for name in known if name not in person.leg.shifts]
    return curves.joint_angles(person.trajectories, names or angles)


def plot_imu(signals: ImuSignals) -> Figure:
    """Plots angular velocity and specific force of each sensor over time."""
    return curves.imu_curves(signals)
