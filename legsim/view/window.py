"""The viewer's window, on a screen or as a picture."""

import importlib.util
import socket
import subprocess
import sys
import time
from pathlib import Path

from legsim.core.errors import LegsimError, file_error


def open_viewer(path: Path) -> None:
    """Opens a recording in the rerun viewer and returns when its window is closed.

    Raises:
        LegsimError: missing file, or the viewer cannot start.
    """
    _must_exist(path)
    outcome = subprocess.run([sys.executable, "-m", "rerun", str(path)], check=False)
    if outcome.returncode != 0:
        raise LegsimError(
            f"the rerun viewer ended with status {outcome.returncode}; it needs a screen and a "
            "graphics driver "
            f"(without them, copy {path} to a machine that has them, or open it at "
            "https://rerun.io/viewer)"
        )


def screenshot(path: Path, picture: Path, *, time_s: float) -> None:
    """Saves the viewer's first view of a recording at ``time_s`` as a PNG.

    It needs a Vulkan driver but no screen.

    Raises:
        LegsimError: missing file, or the viewer cannot start or draw.
    """
    _must_exist(path)
    from rerun.experimental import ViewerClient  # slow to import, and experimental

    try:
        with ViewerClient.spawn(
            headless=True,
            port=_free_port(),
            detach_process=False,
            hide_welcome_screen=True,
            executable_path=str(_executable()),
        ) as viewer:
            viewer.open(str(path.resolve()))
            viewer.set_time("time", duration=time_s, play_state="paused")
            time.sleep(2.0)  # the viewer streams the file; nothing reports when it is done
            picture.write_bytes(viewer.take_screenshot())
    except (RuntimeError, OSError) as error:
        reason = str(error).splitlines()[0]
        raise file_error(
            path,
            f"the rerun viewer cannot draw it ({reason})",
            "install a Vulkan driver (Debian: mesa-vulkan-drivers)",
        ) from error


def _must_exist(path: Path) -> None:
    if not path.is_file():
        raise file_error(
            path,
            "no such recording",
            "run or replay first, or name the folder that holds recording.rrd",
        )


def _executable() -> Path:
    """Finds the viewer that comes with rerun-sdk.

    The environment's folder of commands need not be on the PATH.
    """
    spec = importlib.util.find_spec("rerun_cli")
    if spec is None or spec.origin is None:
        raise LegsimError(
            "this rerun-sdk comes without its viewer; reinstall it with: pip install "
            "--force-reinstall rerun-sdk"
        )
    return Path(spec.origin).with_name("rerun.exe" if sys.platform == "win32" else "rerun")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
