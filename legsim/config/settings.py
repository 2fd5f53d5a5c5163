"""The settings of a run: one frozen tree, read strictly from TOML.

Lengths are in mm, angles in degrees, with the unit in the name.
"""

from pathlib import Path
from typing import Any, ClassVar

import tomli_w
from pydantic import Field, model_validator

from legsim.config.imu import ImuConfig
from legsim.config.methods import MethodsConfig
from legsim.config.motion import MotionConfig
from legsim.config.reconstruction import EvaluationConfig, GridConfig, ReconstructionConfig
from legsim.config.scan import PhantomConfig, ScanConfig
from legsim.config.tree import ConfigSection, merged, parse_override, validated
from legsim.core.errors import LegsimError
from legsim.core.files import load_toml


class RunConfig(ConfigSection):
    """The settings of one scan."""

    has_overrides: ClassVar[bool] = True
    motion: MotionConfig = MotionConfig()
    imu: ImuConfig = ImuConfig()
    phantom: PhantomConfig = PhantomConfig()
    scan: ScanConfig = ScanConfig()
    grid: GridConfig = GridConfig()
    reconstruction: ReconstructionConfig = ReconstructionConfig()
    methods: MethodsConfig = MethodsConfig()
    evaluation: EvaluationConfig = EvaluationConfig()
    seed: int = Field(default=0, ge=0)

    @model_validator(mode="before")
    @classmethod
    def _on_the_scanned_side(cls, tree: Any) -> Any:
        """Puts sensors that are not configured on the scanned leg."""
        if not isinstance(tree, dict):
            return tree
        scan, imu, methods = (_section(tree, name) for name in ("scan", "imu", "methods"))
        if scan is None or imu is None or methods is None or scan.get("side") != "right":
            return tree
        right = [
            s.model_dump() | {"name": f"{s.name[:-1]}r", "segment": f"{s.segment[:-1]}r"}
            for s in ImuConfig().sensors
        ]
        return {
            **tree,
            "imu": {"sensors": right, **imu},
            "methods": {"sensor": right[0]["name"], **methods},
        }


def _section(tree: dict[str, Any], name: str) -> dict[str, Any] | None:
    """The given keys of a section in an unvalidated tree; None where it is not a table."""
    found = tree.get(name, {})
    if isinstance(found, ConfigSection):
        return found.model_dump(exclude_unset=True)
    return found if isinstance(found, dict) else None


PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    "paper": {},
    "half": {
        "scan": {"columns": 310, "rows": 240, "pixel_mm": 1.232},
        "grid": {"voxels": 256, "voxel_mm": 1.0},
    },
    "demo": {
        "scan": {"columns": 310, "rows": 240, "pixel_mm": 1.232},
        "grid": {"voxels": 160, "voxel_mm": 1.6},
    },
}


FILES = (
    *(("motion", key) for key in ("file", "marker_map", "scaling_file", "model")),
    *(("motion", key) for key in ("marker_set", "scale_file", "zero_file")),
    ("motion", "ik", "tasks_file"),
    ("imu", "noise", "kind"),
    ("phantom", "file"),
    ("scan", "spectrum", "file"),
)
"""where settings may name a file; some of them may name what comes with legsim instead"""


def load_settings(
    path: Path | str | None = None, *, preset: str = "paper", overrides: tuple[str, ...] = ()
) -> RunConfig:
    """Reads the preset, overlaid by the TOML file, overlaid by ``section.key=value`` overrides.

    Values of overrides are in TOML's notation, or bare text.

    Raises:
        LegsimError: unknown preset, missing file, not TOML, or a key or value that is not allowed;
            the line names the key.

    >>> load_settings(preset="demo", overrides=("scan.views=124",)).scan.views
    124
    """
    if isinstance(overrides, str):
        overrides = (overrides,)
    where = None if path is None else Path(path)
    trees = [] if where is None else [load_toml(where)]
    return from_trees(
        preset,
        *trees,
        *(parse_override(override, RunConfig) for override in overrides),
        where=where,
    )


def from_trees(preset: str, *trees: dict[str, Any], where: Path | None = None) -> RunConfig:
    """Overlays the preset by ``trees``, one after the other.

    Errors name ``where`` they come from.

    Raises:
        LegsimError: unknown preset, or a key or value that is not allowed; the line names the key.
    """
    if preset not in PRESETS:
        raise LegsimError(f"--preset {preset}: unknown preset; choose one of {', '.join(PRESETS)}")
    tree: dict[str, Any] = merged({}, PRESETS[preset])
    for further in trees:
        tree = merged(tree, further)
    return validated(RunConfig, tree, where)


def dump(config: RunConfig) -> str:
    """Returns the whole tree as TOML, which :func:`load_settings` reads back."""
    return tomli_w.dumps(config.model_dump(mode="json", exclude_none=True))
