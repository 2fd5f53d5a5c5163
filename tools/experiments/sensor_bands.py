"""What sensors read by bands of frequency: a person who stands beside the virtual subjects, on
their bones and as a run simulates them.

`python -m tools.experiments.sensor_bands`, for docs/signals.md and motions/README.md.

"on bones" is the truth of the recordings, "replayed" what a run makes of their markers by itself,
"on skin" the same with the tremor, the mounts and the vibration of tools/experiments/on_skin.toml
(or --skin FILE). With --recording FOLDER, which holds raw exports of Xsens sensors named
standing_shank_l.txt and standing_thigh_l.txt, what they read is printed too.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from legsim import config
from legsim.config import RunConfig
from legsim.core.values import FloatArray
from legsim.imu.signals import ImuSignals
from legsim.run import motion as run_motion
from legsim.run import sensors as run_sensors
from tools.virtual_subjects import sensors
from tools.virtual_subjects.report import MOTIONS
from tools.virtual_subjects.sensors import Measured, Readings
from tools.virtual_subjects.statistics import load_truth
from tools.virtual_subjects.subjects import SUBJECTS

ON_SKIN = Path(__file__).with_name("on_skin.toml")
XSENS_RATE_HZ, XSENS_LONG_AXIS, STANDING_S = 100.0, 0, 10.0


def simulated(settings: RunConfig, seed: int) -> ImuSignals:
    """What the configured sensors read, without the ends of the recording."""
    person = run_motion.solve(settings.motion)
    return sensors.inner(
        run_sensors.sense(person, settings.imu, shaking=np.random.default_rng(seed))
    )


def settings_of(file: Path, trial: str, *, shaken: bool) -> list[RunConfig]:
    """Settings of a file for every subject; without what shakes where it is not wanted."""
    chosen = []
    for k, subject in enumerate(SUBJECTS):
        names = (f"motion.file={subject.name}/{trial}.trc", f"motion.tremor.seed={k}")
        loaded = config.load_settings(file, overrides=names)
        if not shaken:
            plain = [
                s.model_copy(update={"soft_tissue": None, "vibration": None})
                for s in loaded.imu.sensors
            ]
            imu = config.ImuConfig(sensors=tuple(plain))
            motion = loaded.motion.model_copy(update={"tremor": config.TremorConfig()})
            loaded = loaded.model_copy(update={"imu": imu, "motion": motion})
        chosen.append(loaded)
    return chosen


def measured(signals: list[ImuSignals]) -> dict[str, Measured]:
    """Least and most of a trial, by segment."""
    return {segment: sensors.spread(signals, segment) for segment in sensors.STANDING}


def recorded(path: Path) -> Readings:
    """What a raw export of an Xsens sensor holds in its first seconds."""
    rate, force = exported(path)
    count = round(STANDING_S * XSENS_RATE_HZ)
    return sensors.readings(rate[:count], force[:count], XSENS_RATE_HZ, XSENS_LONG_AXIS)


def exported(path: Path) -> tuple[FloatArray, FloatArray]:
    """(rate (n, 3) rad/s, acceleration (n, 3) m/s^2) of a raw export."""
    lines = [line for line in path.read_text("utf-8").splitlines() if not line.startswith("//")]
    names = [name.strip() for name in lines[0].split(",")]
    rows = [line.split(",") for line in lines[1:]]
    rate, force = (
        np.array([[float(row[names.index(f"{kind}_{axis}")]) for axis in "XYZ"] for row in rows])
        for kind in ("Gyr", "Acc")
    )
    return rate, force


def main(
    skin: Annotated[Path, typer.Option()] = ON_SKIN,
    recording: Annotated[Path | None, typer.Option()] = None,
) -> None:
    """Prints the table of each trial."""
    for trial in ("squat_30", "squat_60"):
        bones = [
            sensors.on_bones(load_truth(str(MOTIONS / s.name / f"{trial}_truth.npz")))
            for s in SUBJECTS
        ]
        runs = {
            shaken: [simulated(s, k) for k, s in enumerate(settings_of(skin, trial, shaken=shaken))]
            for shaken in (False, True)
        }
        print(f"{trial}\n")
        columns = {
            "a person who stands": sensors.STANDING,
            "on bones": measured(bones),
            "replayed": measured(runs[False]),
            "on skin": measured(runs[True]),
        }
        print("\n".join(sensors.table(columns)), end="\n\n")
    if recording is not None:
        for segment in sensors.STANDING:
            print(f"{segment}_l: {recorded(recording / f'standing_{segment}_l.txt')}")


if __name__ == "__main__":
    typer.run(main)
