"""Who holds the body up: muscles with intrinsic stiffness, and a neural controller that feels the
sway late and noisily.

Balance of the whole body follows the independent channel model of Peterka (2002, J Neurophysiol
88:1097-1118): a proportional-derivative controller on the sway of the mass center, behind a neural
delay and second-order activation dynamics, beside a small intrinsic stiffness of the ankles.
Numbers: the default values of PMC5664365, table 1 (J 66 kg m^2, m 75 kg, h 0.83 m, so m g h = 611 N
m/rad), kept as multiples of m g h so that they go with a person's size and with the depth of the
squat. The torque becomes a horizontal force on the mass center, spread over the joints by the
transposed Jacobian (virtual-model control), forwards and sideways alike.

Noise has the two sources that van der Kooij and Peterka (2011, J Comput Neurosci 30:759-778) found
necessary: sensory noise, which the controller takes for sway, and motor noise; both grow with what
the muscles do. Motor noise has a coefficient of variation (Hamilton, Jones and Wolpert 2004, Exp
Brain Res 157:417-430). Both are low-pass filtered Gaussian noise. The published sources fix form
and order of magnitude; the sizes below were set so that the sway lies in the range measured in
quiet standing (motions/README.md).

Muscles that hold still twitch, and tremble at 8 to 12 Hz. The error of a held force grows linearly
with the force from a value above 0, and the frequency of its peak near 8 to 10 Hz does not depend
on the force (Sutton and Sykes 1967, J Physiol 191:699-711). Ankles tremble at 6 to 9 Hz (Pozos,
Iaizzo and Petry 1982, J Appl Physiol 52:226-230). Sizes were set by what sensors on the shanks of
one standing person read (motions/README.md).
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, fftconvolve, sosfilt

from legsim.core.values import FloatArray

_REFERENCE_LOAD = 75.0 * 9.81 * 0.83


@dataclass(frozen=True, slots=True)
class ControllerParams:
    """What is chosen; rates in 1/s, the rest as said."""

    proportional: float = 943.9 / _REFERENCE_LOAD
    """neural torque per sway angle, in m g h"""
    derivative: float = 313.5 / _REFERENCE_LOAD
    """neural torque per sway rate, in m g h times s"""
    ankle_stiffness: float = 40.5 / _REFERENCE_LOAD
    """intrinsic, both ankles, in m g h"""
    ankle_damping: float = 68.8 / _REFERENCE_LOAD
    """intrinsic, both ankles, in m g h times s"""
    delay: float = 0.097
    """s, neural"""
    activation_rate: float = 16.8
    """rad/s, natural frequency of the muscles' activation"""
    activation_damping: float = 0.99
    joint_stiffness: float = 4.0
    """1/rad: stiffness of a contracted muscle per torque (Hunter and Kearney 1982, J Biomech
    15:747-752: proportional to torque)
    """
    damping_time: float = 0.04
    """s: damping over stiffness of all joints but the ankles"""
    sole_stiffness: float = 50.0
    """N m/rad of a foot that turns on its sole about the vertical, at 75 kg: chosen"""
    sensory_deg: float = 0.011
    """standard deviation of the error of the felt sway, without effort"""
    sensory_effort: float = 6.0
    """growth of that error per effort; effort is the knees' mean torque over body weight times 0.1
    m (0.3 at 30 deg, 0.55 at 60 deg)
    """
    sensory_time: float = 1.0
    """s: correlation time of the sensory noise"""
    motor_variation: float = 0.013
    """standard deviation of a torque over its mean"""
    motor_floor: float = 0.10
    """N m, of a muscle without load, at 75 kg"""
    motor_times: tuple[float, float] = (0.2, 2.0)
    """s: correlation times of the two halves of the motor noise"""
    unrest_floor: float = 0.10
    """N m: standard deviation of the twitching of a muscle without load, at 75 kg"""
    unrest_variation: float = 0.001
    """growth of that per torque"""
    unrest_time: float = 0.06
    """s: a muscle's twitch"""
    tremor: float = 0.45
    """standard deviation of the tremor over that of the twitching"""
    tremor_band: tuple[float, float] = (8.0, 12.0)
    """Hz"""


REST_STIFFNESS = {
    "lumbar_extension": 400.0,
    "lumbar_bending": 400.0,
    "lumbar_rotation": 200.0,
    "hip_flexion": 150.0,
    "hip_adduction": 200.0,
    "hip_rotation": 80.0,
    "knee_angle": 100.0,
    "ankle_angle": 0.0,
    "subtalar_angle": 60.0,
}
"""N m/rad at 75 kg and 1.80 m with muscles at rest in stance, without the part that goes with
torque
"""


def rest_stiffness(name: str, mass: float) -> float:
    """N m/rad of one joint for a person of this mass."""
    return REST_STIFFNESS[name.removesuffix("_r").removesuffix("_l")] * mass / 75.0


def filtered_noise(rng: np.random.Generator, samples: int, step: float, time: float) -> FloatArray:
    """(samples,) stationary Gaussian noise of unit variance behind two equal first-order low-passes
    of time constant ``time`` (s).
    """
    decay = np.exp(-step / time)
    out = np.empty(samples)
    # stationary start of x' = (u - x)/T, y' = (x - y)/T with var x = 2 for var y = 1; cov = 1
    first, second = rng.multivariate_normal([0, 0], [[2.0, 1.0], [1.0, 1.0]])
    drive = rng.standard_normal(samples) * np.sqrt(2.0 * (1 - decay**2))
    for k in range(samples):
        first = decay * first + drive[k]
        second = decay * second + (1 - decay) * first
        out[k] = second
    return out


def band_noise(
    rng: np.random.Generator, samples: int, step: float, band: tuple[float, float]
) -> FloatArray:
    """(samples,) stationary Gaussian noise of unit variance behind a 2nd-order Butterworth
    band-pass (Hz).
    """
    sections = butter(2, band, btype="band", fs=1 / step, output="sos")
    response = sosfilt(sections, np.eye(1, round(20 / (band[1] - band[0]) / step))[0])
    drive = rng.standard_normal(samples + len(response) - 1)
    return fftconvolve(drive, response / np.linalg.norm(response), "valid")


def smooth_noise(
    rng: np.random.Generator, samples: int, columns: int, step: float, time: float
) -> FloatArray:
    """(samples, columns) Gaussian noise of unit variance with the correlation exp(-t^2 / 2 time^2):
    smooth in all derivatives.
    """
    reach = round(3 * time / step)
    kernel = np.exp(-np.square(np.arange(-reach, reach + 1) * step / time))
    white = rng.standard_normal((samples + 2 * reach, columns))
    return np.stack(
        [np.convolve(column, kernel / np.linalg.norm(kernel), "valid") for column in white.T], -1
    )


class DelayedFeedback:
    """The neural path of one direction of sway: delay, gains, activation dynamics; stepped at
    ``step`` seconds.
    """

    def __init__(self, params: ControllerParams, step: float) -> None:
        self._params, self._step = params, step
        self._line = np.zeros((round(params.delay / step), 2))
        self._at = 0
        self._torque, self._rate = 0.0, 0.0

    def __call__(self, angle: float, rate: float, load: float, gain: float) -> float:
        """Torque (N m) now, for the sway angle (rad) and rate felt now; ``load`` is m g h."""
        params = self._params
        late_angle, late_rate = self._line[self._at]
        self._line[self._at] = angle, rate
        self._at = (self._at + 1) % len(self._line)
        wanted = -gain * load * (params.proportional * late_angle + params.derivative * late_rate)
        w = params.activation_rate
        self._rate += self._step * (
            w * w * (wanted - self._torque) - 2 * params.activation_damping * w * self._rate
        )
        self._torque += self._step * self._rate
        return self._torque
