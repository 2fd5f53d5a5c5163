"""A scan or a moving person in the rerun viewer: in the cell of a notebook, or in a window."""

import subprocess
import sys
import tempfile
from pathlib import Path

from legsim.core.errors import LegsimError
from legsim.geometry.volume import NamedVolume, Volume
from legsim.imu.simulation import simulate_imu
from legsim.kinematics.moving_leg import MovingLeg
from legsim.scene import build
from legsim.scene.slices import VolumeSlices
from legsim.scene.values import ReplayScene, ScanScene
from legsim.simulation.simulated_scan import SimulatedScan
from legsim.view import recording


def show(
    content: SimulatedScan | MovingLeg,
    *volumes: Volume,
    path: Path | str | None = None,
    **named: Volume,
) -> object:
    """Shows a scan, or a person that moves, with volumes as slices, in the rerun viewer.

    In a notebook the viewer is the cell's output (needs the extra "notebook"); elsewhere a window
    opens and Python continues.

    Args:
        content: a simulated scan, or a person.
        volumes: of that scan, named "volume", "volume 2" and so on.
        path: writes the recording there and opens nothing; for machines without a screen.
        named: volumes by name, as in ``show(scan, rigid=volume)``.

    Raises:
        LegsimError: volumes of a person who was not scanned; a notebook without the extra.

    >>> show(scan, rigid=volume, path="scan.rrd")
    """
    scene = _scene(content, _named(volumes, named))
    if path is not None:
        _write(Path(path), scene)
        return None
    if _in_notebook():
        return _notebook_viewer(scene)
    file = Path(tempfile.mkdtemp(prefix="legsim-"), "recording.rrd")
    _write(file, scene)
    subprocess.Popen([sys.executable, "-m", "rerun", str(file)])
    return None


def _named(volumes: tuple[Volume, ...], named: dict[str, Volume]) -> list[NamedVolume]:
    unnamed = ("volume" if k == 0 else f"volume {k + 1}" for k in range(len(volumes)))
    pairs = [*zip(unnamed, volumes, strict=True), *named.items()]
    return [NamedVolume(name, volume) for name, volume in pairs]


def _scene(
    content: SimulatedScan | MovingLeg, volumes: list[NamedVolume]
) -> ReplayScene | ScanScene:
    if isinstance(content, SimulatedScan):
        return build.scan_scene(content, [VolumeSlices.of(one) for one in volumes])
    if not isinstance(content, MovingLeg):
        raise LegsimError(
            f"show takes a simulated scan or a moving leg, not {type(content).__name__}"
        )
    if volumes:
        raise LegsimError("volumes are shown with the scan that they come from: show(scan, volume)")
    return build.replay_scene(content, simulate_imu(content))


def _write(path: Path, scene: ReplayScene | ScanScene) -> None:
    if isinstance(scene, ScanScene):
        recording.write_scan(path, scene)
    else:
        recording.write_replay(path, scene)


def _in_notebook() -> bool:
    """Whether a kernel runs this, which has a browser to show things in."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return shell is not None and type(shell).__name__ == "ZMQInteractiveShell"


def _notebook_viewer(scene: ReplayScene | ScanScene) -> object:
    try:
        from rerun.notebook import Viewer

        stream = recording.new_stream(scene)
        viewer = Viewer(recording=stream, blueprint=recording.blueprint(scene))
    except ImportError as error:  # also rerun's own for a missing rerun-notebook
        raise LegsimError(
            f"the viewer cannot be shown in a notebook ({error}); install it with "
            "pip install 'legsim[notebook]', or write a file with show(..., path='scan.rrd')"
        ) from error
    recording.record(stream, scene)
    return viewer
