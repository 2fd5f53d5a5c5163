"""The seven virtual subjects: size, proportions, stance and habits. All invented: nobody was measured."""

from dataclasses import dataclass

Scale = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Subject:
    """A person as scale factors of gait2392 (1.80 m, 75.16 kg) and a way to stand; scale factors are along x, y, z of the segment."""

    name: str
    sex: str
    height: float
    """m"""
    mass: float
    """kg, whole body"""
    pelvis: Scale
    torso: Scale
    thigh: Scale
    shank: Scale
    foot: Scale
    left_thigh_longer: float
    """left over right thigh length, minus one"""
    left_shank_longer: float
    """left over right shank length, minus one"""
    stance_width: float
    """m between the ankle centers"""
    toe_out_deg: tuple[float, float]
    """right, left"""
    trunk_lean: float
    """forward lean of the trunk per knee flexion"""
    pelvis_tilt: float
    """forward tilt of the pelvis per knee flexion"""
    com_forward: float
    """m; how far before the ankles the mass center is held"""
    com_right: float
    """m; how far the weight is shifted towards the right foot"""
    heading_deg: float
    """turn about the vertical, positive to the left"""
    place: tuple[float, float]
    """m; x and z of the middle between the ankles on the floor"""
    gain: float
    """postural feedback against the published mean"""
    noise: float
    """unsteadiness against the mean of the seven"""
    squat_depth_deg: float
    """knee flexion at the bottom of the active squats"""


SUBJECTS = (
    Subject(
        name="subject01", sex="m", height=1.80, mass=75.2,
        pelvis=(1.00, 1.00, 1.00), torso=(1.00, 1.00, 1.00), thigh=(1.00, 1.00, 1.00), shank=(1.00, 1.00, 1.00), foot=(1.00, 1.00, 1.00),
        left_thigh_longer=0.0, left_shank_longer=0.004,
        stance_width=0.26, toe_out_deg=(12.0, 13.0), trunk_lean=0.42, pelvis_tilt=0.30, com_forward=0.045, com_right=0.004,
        heading_deg=2.0, place=(0.03, -0.02), gain=1.00, noise=1.00, squat_depth_deg=88.0,
    ),
)  # fmt: skip
