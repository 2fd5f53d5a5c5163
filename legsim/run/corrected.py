"""From a method's correction to its volume: the stage that simulated and measured scans share."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from legsim.config import ReconstructionConfig
from legsim.core.files import write_text
from legsim.core.progress import OnProgress
from legsim.core.values import FloatArray
from legsim.correction import image_warp
from legsim.correction.method import Correction
from legsim.deformation.files import load_motion, save_motion
from legsim.deformation.models import ControlPointMotion, Motion, placed
from legsim.evaluation.regions import Box
from legsim.evaluation.similarity import ReconstructedAt
from legsim.geometry import image_files
from legsim.geometry.cone_beam import Projections
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
    own_images: bool
    """whether the method changed the images otherwise than by ``warped_by``"""

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
    recorded: Projections | None = None
    """what the methods were given; None where nobody asks whose the images are"""

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
        said = {"method": label, "notes": found.notes, "own_images": self._own_images(found)}
        write_text(folder / files[1], json.dumps(said, indent=1) + "\n")
        volume = reconstruction.reconstruct(
            self.settings,
            found,
            self.grid,
            device=self.device,
            progress=partial(self.on_progress, f"reconstructing {label}"),
        )
        image_files.save_volume(folder / files[0], volume)
        return files

    def _own_images(self, found: Correction) -> bool:
        """Whether the images are neither those that were recorded nor these warped."""
        images = self.recorded
        if images is None or found.projections is images:
            return False
        if found.warped_by is not None:
            images = image_warp.warp_images(images, found.warped_by, self.device)
        return not np.array_equal(found.projections.line_integrals, images.line_integrals)

    def _load(self, label: str) -> Reconstructed:
        folder = self.folder
        motion, warp = (
            load_motion(folder.path / name) if folder.has(name) else None
            for name in (f"motion-{label}.npz", f"warp-{label}.npz")
        )
        said = json.loads((folder.path / f"correction-{label}.json").read_text("utf-8"))
        return Reconstructed(
            label,
            folder.path / f"volume-{label}.mha",
            motion,
            warp if isinstance(warp, ControlPointMotion) else None,
            tuple(said["notes"]),
            said["own_images"],
        )


def reconstructed_at(
    one: Reconstructed,
    recorded: Projections,
    settings: ReconstructionConfig,
    grid: VolumeGrid,
    device: Device,
) -> ReconstructedAt | None:
    """What makes the volume of a method anew, elsewhere; None where its images are not kept.

    ``recorded`` are the images that the method was given, ``grid`` that of its volume.
    """
    if one.own_images:
        return None

    def at(matrix: FloatArray, box: Box) -> Volume:
        images, warp = recorded, one.warped_by
        if warp is not None:
            images = image_warp.warp_images(images, warp, device)
        motion = placed(one.motion, images.geometry.times, matrix, grid)
        if settings.algorithm == "fdk":  # no voxel depends on another
            wanted = grid.cropped(box)
            return reconstruction.reconstruct(
                settings, images, wanted, motion=motion, device=device
            )
        whole = reconstruction.reconstruct(settings, images, grid, motion=motion, device=device)
        return Volume(grid.cropped(box), whole.attenuation[box])

    return at
