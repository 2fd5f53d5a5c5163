"""Settings of inverse kinematics."""

from typing import Any

from pydantic import Field, field_validator, model_validator

from legsim.config.tree import ConfigSection


class ValueConfig(ConfigSection):
    """A coordinate's value, as an angle or as a length; empty: the model's default."""

    value_deg: float | None = None
    value_mm: float | None = None

    @model_validator(mode="after")
    def _one_value(self) -> "ValueConfig":
        if self.value_deg is not None and self.value_mm is not None:
            raise ValueError("give value_deg or value_mm, not both")
        return self


class TaskConfig(ValueConfig):
    """OpenSim's IKCoordinateTask: a coordinate is pulled to a value, in place of its prior."""

    weight: float = Field(ge=0)
    """as in OpenSim (m^2/rad^2, over the weighted mean of the markers); 0 is no task"""


class PriorsConfig(ConfigSection):
    """How strong the model's own priors are: 1 as they are, 0 off, 2 twice the weight."""

    hip_rotation: float = Field(default=1.0, ge=0)
    """toward the habitual rotation, where the markers of the thigh leave it open"""
    flat_foot: float = Field(default=1.0, ge=0)
    """a foot without markers stands flat"""
    subtalar: float = Field(default=1.0, ge=0)
    toes: float = Field(default=1.0, ge=0)
    hyperextension: float = Field(default=1.0, ge=0)
    """a knee that is overextended by more than 10 degrees is drawn back"""
    default_posture: float = Field(default=1.0, ge=0)
    """of a user's own OpenSim model: all other coordinates toward their defaults"""


class IkConfig(ConfigSection):
    """How markers become joint coordinates."""

    tasks_file: str = ""
    """OpenSim's IKTaskSet or set-up of inverse kinematics (.xml); empty: none

    The settings beside it override it.
    """
    marker_weights: dict[str, float] = Field(default_factory=dict)
    """by the recording's label or by role; 0 leaves a marker out; others keep the model's"""
    tasks: dict[str, TaskConfig] = Field(default_factory=dict)
    """by coordinate"""
    locked: dict[str, ValueConfig] = Field(default_factory=dict)
    """coordinates that stay at a value: a list, or a table with values"""
    priors: PriorsConfig = PriorsConfig()

    @field_validator("marker_weights", mode="before")
    @classmethod
    def _with_dots(cls, weights: Any) -> Any:
        """Joins what TOML takes apart: R.Heel = 0 and --set motion.ik.marker_weights.R.Heel=0."""
        return dict(_leaves(weights)) if isinstance(weights, dict) else weights

    @field_validator("locked", mode="before")
    @classmethod
    def _from_list(cls, locked: Any) -> Any:
        """A name or a list of names stands for locks at the default."""
        locked = [locked] if isinstance(locked, str) else locked
        if isinstance(locked, list) and all(isinstance(name, str) for name in locked):
            return {name: {} for name in locked}
        return locked


def _leaves(tree: dict[str, Any], start: str = "") -> list[tuple[str, Any]]:
    """Values of nested tables by their keys, joined with dots."""
    found = []
    for key, value in tree.items():
        inner = isinstance(value, dict)
        found += _leaves(value, f"{start}{key}.") if inner else [(f"{start}{key}", value)]
    return found
