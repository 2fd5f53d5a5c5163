"""Recordings of single sensors."""

import numpy as np

from legsim.imu.recording import ImuRecording


def still(count: int = 100, rate_hz: float = 100.0, seed: int = 0) -> ImuRecording:
    """A sensor at rest, z up, with the noise of a good one."""
    rng = np.random.default_rng(seed)
    force = np.array([0, 0, 9.80665]) + 0.02 * rng.normal(size=(count, 3))
    return ImuRecording(
        "shank", np.arange(count) / rate_hz, 0.002 * rng.normal(size=(count, 3)), force
    )


def swaying(seconds: float = 12.0, rate_hz: float = 100.0, lean: float = 0.1) -> ImuRecording:
    """A sensor that leans to all sides about a fixed point, ``lean`` rad, at 0.3 and 0.5 Hz."""
    times = np.arange(round(seconds * rate_hz)) / rate_hz
    a, b = 2 * np.pi * 0.3, 2 * np.pi * 0.5
    roll, pitch = lean * np.sin(a * times), lean * np.sin(b * times)
    # world from sensor is a turn about x, then about the turned y; gravity along world z
    force = 9.80665 * np.stack(
        [-np.cos(roll) * np.sin(pitch), np.sin(roll), np.cos(roll) * np.cos(pitch)], -1
    )
    along_x = a * lean * np.cos(a * times)
    rate = np.stack(
        [along_x * np.cos(pitch), b * lean * np.cos(b * times), along_x * np.sin(pitch)], -1
    )
    return ImuRecording("shank", times, rate, force)
