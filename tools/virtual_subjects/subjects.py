"""The seven virtual subjects: size, proportions, stance and habits. All invented: nobody was
measured.
"""

from dataclasses import dataclass

Scale = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Subject:
    """A person as scale factors of gait2392 (1.80 m, 75.16 kg) and a way to stand; scale factors
    are along x, y, z of the segment.
    """

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
    twist_deg: float
    """turn of the pelvis against the feet, positive to the left"""
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
    draw: int = 0
    """which random draw is kept: one in which the deeper squat sways more, as on average, and both
    within the measured ranges
    """


SUBJECTS = (
    Subject(
        name="subject01",
        sex="m",
        height=1.8,
        mass=75.2,
        pelvis=(1.0, 1.0, 1.0),
        torso=(1.0, 1.0, 1.0),
        thigh=(1.0, 1.0, 1.0),
        shank=(1.0, 1.0, 1.0),
        foot=(1.0, 1.0, 1.0),
        left_thigh_longer=0.0,
        left_shank_longer=0.002,
        stance_width=0.26,
        toe_out_deg=(12.0, 13.0),
        trunk_lean=0.42,
        pelvis_tilt=0.3,
        com_forward=0.045,
        com_right=0.004,
        twist_deg=0.5,
        heading_deg=2.0,
        place=(0.03, -0.02),
        gain=0.84,
        noise=1.0,
        squat_depth_deg=88.0,
    ),
    Subject(
        name="subject02",
        sex="f",
        height=1.63,
        mass=56.4,
        pelvis=(0.93, 0.91, 0.98),
        torso=(0.9, 0.905, 0.87),
        thigh=(0.92, 0.9, 0.92),
        shank=(0.91, 0.885, 0.9),
        foot=(0.89, 0.89, 0.87),
        left_thigh_longer=0.003,
        left_shank_longer=0.0,
        stance_width=0.22,
        toe_out_deg=(8.0, 10.0),
        trunk_lean=0.5,
        pelvis_tilt=0.36,
        com_forward=0.04,
        com_right=-0.006,
        twist_deg=-1.0,
        heading_deg=-3.0,
        place=(-0.05, 0.04),
        gain=0.8,
        noise=0.9,
        squat_depth_deg=92.0,
        draw=2,
    ),
    Subject(
        name="subject03",
        sex="m",
        height=1.91,
        mass=93.0,
        pelvis=(1.05, 1.06, 1.05),
        torso=(1.08, 1.05, 1.09),
        thigh=(1.07, 1.075, 1.08),
        shank=(1.06, 1.07, 1.07),
        foot=(1.06, 1.06, 1.06),
        left_thigh_longer=-0.002,
        left_shank_longer=0.003,
        stance_width=0.33,
        toe_out_deg=(18.0, 20.0),
        trunk_lean=0.46,
        pelvis_tilt=0.28,
        com_forward=0.055,
        com_right=0.008,
        twist_deg=1.5,
        heading_deg=5.0,
        place=(0.08, 0.01),
        gain=0.88,
        noise=1.1,
        squat_depth_deg=84.0,
    ),
    Subject(
        name="subject04",
        sex="f",
        height=1.7,
        mass=66.8,
        pelvis=(0.98, 0.95, 1.04),
        torso=(0.95, 0.945, 0.94),
        thigh=(0.96, 0.955, 0.97),
        shank=(0.95, 0.94, 0.95),
        foot=(0.94, 0.93, 0.93),
        left_thigh_longer=0.002,
        left_shank_longer=-0.003,
        stance_width=0.28,
        toe_out_deg=(15.0, 11.0),
        trunk_lean=0.38,
        pelvis_tilt=0.24,
        com_forward=0.048,
        com_right=-0.003,
        twist_deg=-0.8,
        heading_deg=-6.0,
        place=(0.0, -0.07),
        gain=0.82,
        noise=0.85,
        squat_depth_deg=95.0,
    ),
    Subject(
        name="subject05",
        sex="m",
        height=1.74,
        mass=84.5,
        pelvis=(1.03, 0.98, 1.04),
        torso=(1.04, 0.975, 1.06),
        thigh=(1.02, 0.955, 1.05),
        shank=(1.0, 0.95, 1.04),
        foot=(0.99, 0.97, 1.02),
        left_thigh_longer=-0.003,
        left_shank_longer=0.0,
        stance_width=0.31,
        toe_out_deg=(22.0, 19.0),
        trunk_lean=0.52,
        pelvis_tilt=0.34,
        com_forward=0.042,
        com_right=0.01,
        twist_deg=1.2,
        heading_deg=1.0,
        place=(-0.02, 0.06),
        gain=0.86,
        noise=1.15,
        squat_depth_deg=80.0,
    ),
    Subject(
        name="subject06",
        sex="f",
        height=1.58,
        mass=50.3,
        pelvis=(0.9, 0.88, 0.95),
        torso=(0.86, 0.88, 0.83),
        thigh=(0.88, 0.87, 0.87),
        shank=(0.87, 0.865, 0.86),
        foot=(0.86, 0.87, 0.85),
        left_thigh_longer=0.0,
        left_shank_longer=0.004,
        stance_width=0.21,
        toe_out_deg=(6.0, 7.0),
        trunk_lean=0.44,
        pelvis_tilt=0.32,
        com_forward=0.036,
        com_right=0.002,
        twist_deg=0.3,
        heading_deg=-1.0,
        place=(0.05, 0.09),
        gain=0.78,
        noise=0.9,
        squat_depth_deg=90.0,
        draw=1,
    ),
    Subject(
        name="subject07",
        sex="m",
        height=1.86,
        mass=73.5,
        pelvis=(1.0, 1.02, 0.98),
        torso=(1.0, 1.015, 0.97),
        thigh=(1.02, 1.065, 1.0),
        shank=(1.01, 1.055, 0.98),
        foot=(1.04, 1.02, 0.99),
        left_thigh_longer=0.003,
        left_shank_longer=0.002,
        stance_width=0.24,
        toe_out_deg=(9.0, 14.0),
        trunk_lean=0.4,
        pelvis_tilt=0.26,
        com_forward=0.05,
        com_right=-0.009,
        twist_deg=-1.8,
        heading_deg=8.0,
        place=(-0.07, -0.04),
        gain=0.85,
        noise=1.05,
        squat_depth_deg=86.0,
        draw=2,
    ),
)
