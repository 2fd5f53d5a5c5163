"""From a method's correction to its volume: the stage that simulated and measured scans share."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from legsim.config import ReconstructionConfig
from legsim.core.files import write_text
from legsim.core.progress import OnProgress
from legsim.correction.method import Correction
from legsim.deformation.files import load_motion, save_motion
from legsim.deformation.models import ControlPointMotion, Motion
from legsim.geometry import image_files
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device
from legsim.run import methods, reconstruction
from legsim.run.folder import RunFolder


@dataclass(frozen=True, slots=True, eq=False)
class Reconstructed:
    """Result of one method; its volume stays in its file, since a scan's do not fit in memory."""

    name: str
    file: Path
    motion: Motion | None
    """motion that the back-projection followed"""
    warped_by: ControlPointMotion | None
    """points by which the images were warped"""
    notes: tuple[str, ...]

    def load(self) -> Volume:
        """Reads the volume."""
        return image_files.load_volume(self.file)


@dataclass(frozen=True, slots=True, eq=False)
class Reconstructor:
    """Where and how the volumes of all methods of a scan are made."""

    folder: RunFolder
    settings: ReconstructionConfig
    grid: VolumeGrid
    device: Device
    on_progress: OnProgress

    def of(self, name: str, key: str, correct: Callable[[], Correction]) -> Reconstructed:
        """Corrects and reconstructs as a stage, unless the folder has it under this key."""
        label = methods.label(name)
        self.folder.cached(f"volume-{label}", key, partial(self._make, label, correct))
        return self._load(label)

    def _make(self, label: str, correct: Callable[[], Correction]) -> list[str]:
        """Runs one method and writes its volume, motion and notes."""
        folder = self.folder.path
        files = [f"volume-{label}.mha", f"correction-{label}.json"]
        self.on_progress(f"estimating {label}", 0, 1)
        found = correct()
        self.on_progress(f"estimating {label}", 1, 1)
        for kind, motion in (("motion", found.motion), ("warp", found.warped_by)):
            if motion is not None:
                files.append(f"{kind}-{label}.npz")
                save_motion(folder / files[-1], motion)
        notes = json.dumps({"method": label, "notes": found.notes}, indent=1) + "\n"
        write_text(folder / files[1], notes)
        volume = reconstruction.reconstruct(
            self.settings,
            found,
            self.grid,
            device=self.device,
            progress=partial(self.on_progress, f"reconstructing {label}"),
        )
        image_files.save_volume(folder / files[0], volume)
        return files

    def _load(self, label: str) -> Reconstructed:
        folder = self.folder
        motion, warp = (
            load_motion(folder.path / name) if folder.has(name) else None
            for name in (f"motion-{label}.npz", f"warp-{label}.npz")
        )
        notes = json.loads((folder.path / f"correction-{label}.json").read_text("utf-8"))["notes"]
        return Reconstructed(
            label,
            folder.path / f"volume-{label}.mha",
            motion,
            warp if isinstance(warp, ControlPointMotion) else None,
            tuple(notes),
        )
