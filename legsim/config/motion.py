"""Settings of the recording and of its kinematics."""

from typing import Literal

from pydantic import Field

from legsim.config.ik import IkConfig
from legsim.config.tree import Band, ConfigSection


class TremorConfig(ConfigSection):
    """Tremor of the bones, which the filters of a replay took out of the recording.

    Images, sensors and truth have it. Feet stay where they are; each muscle trembles for itself.
    """

    acceleration_mg: float = Field(default=0.0, ge=0)
    """RMS of the knees' acceleration; 0 adds none"""
    band_hz: Band = (8.0, 12.0)
    seed: int = Field(default=0, ge=0)
    """of the tremor alone: all runs of a study see the same"""


class MotionConfig(ConfigSection):
    """The recording and how it is cleaned."""

    file: str = "subject01/squat_60.trc"
    """a path, or the name of one of the shipped recordings under motions/"""
    marker_map: str = "auto"
    """a TOML file, the name of a shipped marker set, or "auto"

    "auto" takes the shipped one that covers the file.
    """
    unit: Literal["file", "m", "cm", "mm"] = "file"
    """"file" takes the header's unit"""
    up: Literal["file", "x", "y", "z", "-x", "-y", "-z"] = "file"
    """"file" takes the file's, or guesses it where the format does not state it"""
    angles: Literal["file", "degrees", "radians"] = "file"
    """unit of joint coordinates; "file" takes the header's unless the angles contradict it"""
    filter_hz: float = Field(default=6.0, ge=0)
    """cut-off of the 2nd-order zero-phase Butterworth filter; 0 leaves the markers as they are"""
    longest_gap_s: float = Field(default=2.0, ge=0)
    """longest gap that is interpolated in time

    In longer ones the marker stays unseen and is reported.
    """
    marker_noise_mm: float = Field(default=0.2, ge=0)
    """RMS of a marker's white noise per axis; 0 leaves the joint angles as the filter does

    Joint angles are filtered further, as low as that noise hides.
    """
    scaling_file: str = ""
    """recording that the model is scaled from

    Empty: the person's active squats for legsim's own recordings, else the same one.
    """
    model: str = ""
    """OpenSim model (.osim) to use, with its own markers; empty: legsim's own leg"""
    marker_set: str = ""
    """OpenSim's marker set (.xml) for the model: its markers replace the model's own of the same
    names, and are added to the others; empty: none
    """
    scale_file: str = ""
    """OpenSim's scale factors (.xml), for legsim's own leg or for the model; empty: none"""
    scale_model: bool = False
    """scale the model to the person by its own markers, and place these where the person wears
    them; from ``scaling_file`` where that is given
    """
    zero_file: str = ""
    """static trial whose mean pose is the zero of the joint angles in the report and in
    coordinates_from_zero.mot; the movement stays as it is; empty: the model's own zero
    """
    registration: bool = True
    """find lengths, hip centers and the places of the markers together with the poses

    Else the leg stays as scaled and markers sit where the model has them.
    """
    implausible: Literal["refuse", "scan"] = "refuse"
    """what becomes of a movement that no leg makes (steps, rates, unlike lengths, a poor fit)

    "scan" is what --force sets.
    """
    ik: IkConfig = IkConfig()
    tremor: TremorConfig = TremorConfig()
