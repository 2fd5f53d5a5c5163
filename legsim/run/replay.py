"""Kinematics, IMU signals and a recording of one motion file, without a scan."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from legsim import __version__, config, view
from legsim.config import RunConfig
from legsim.core import files
from legsim.core.files import key_of
from legsim.core.progress import OnProgress
from legsim.imu import plausibility as imu_plausibility
from legsim.report import imu_section, replay_page
from legsim.report import page as report_page
from legsim.run import code, imu_comparison, stages
from legsim.run import motion as run_motion
from legsim.run import sensors as run_sensors
from legsim.run.folder import RunFolder, commit
from legsim.run.imu_files import WornSensor
from legsim.scene import build


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """Result of a replay."""

    text: tuple[str, ...]

    def lines(self) -> tuple[str, ...]:
        """Formats the output."""
        return self.text


def replay(
    settings: RunConfig,
    out: Path,
    *,
    filtered: bool,
    image: Path | None,
    on_progress: OnProgress,
    measured: Sequence[str] = (),
) -> ReplayResult:
    """Computes kinematics, IMU signals and a recording of one motion file; nothing is scanned.

    ``measured`` are files of real sensors (or SEGMENT=FILE) to set beside the predicted ones.
    """
    run_sensors.check(settings.imu)
    worn = tuple(one for text in measured for one in imu_comparison.of_argument(text))
    about = {
        "legsim": __version__,
        "commit": commit(),
        "config_hash": key_of(config.dump(settings)),
        "sensors": run_sensors.noise_sentence(settings.imu, view_rate_hz=settings.scan.rate_hz),
    }
    with RunFolder(out, about, kind="replay") as folder:
        return _replay(
            settings, folder, worn, filtered=filtered, image=image, on_progress=on_progress
        )


def _replay(
    settings: RunConfig,
    folder: RunFolder,
    worn: tuple[WornSensor, ...],
    *,
    filtered: bool,
    image: Path | None,
    on_progress: OnProgress,
) -> ReplayResult:
    out = folder.path
    on_progress("joint angles", 0, 1)
    person = run_motion.solve(settings.motion, filter_coordinates=filtered)
    key = stages.motion_key(settings)
    key = key_of(key, filtered) if filtered else key
    stages.write_kinematics(person, folder, key)
    on_progress("joint angles", 1, 1)
    on_progress("sensors", 0, 1)
    first = float(person.trajectories.times[0])
    signals = stages.read_sensors(settings, person, folder, key, rest_at=first)
    compared = imu_comparison.compare(worn, signals, settings.imu.clock_offset_s, person)
    lines = [line for one in compared for line in one.lines()]
    on_progress("sensors", 1, 1)
    on_progress("recording", 0, 1)
    scene = build.replay_scene(person, signals)
    provenance = (
        *folder.about.items(),
        ("command", shlex.join(["legsim", "replay", settings.motion.file, "--out", str(out)])),
    )
    posture = cache(lambda: replay_page.still(scene))

    def write() -> tuple[str, ...]:
        view.write_replay(out / "recording.rrd", scene)
        found = [one.found for one in compared]
        sections = [imu_section.imu_section(found, lines)] if found else []
        page = replay_page.content(person, scene, posture(), provenance, sections)
        files.write_text(out / "report.html", report_page.render(page))
        if not found:
            return "recording.rrd", "report.html"
        files.write_text(out / imu_comparison.FILE, imu_comparison.table(compared))
        return "recording.rrd", "report.html", imu_comparison.FILE

    table = imu_comparison.table(compared)
    decided_by = key_of(
        key, code.fingerprint("replay"), provenance, table, lines, folder.hash_of("imu.csv")
    )
    folder.cached("replay", decided_by, write)
    if image is not None:
        files.write_bytes(image, posture())
    on_progress("recording", 1, 1)
    doubts = [f"warning: {line}" for line in imu_plausibility.objections(signals)]
    shown = [*doubts, *replay_page.replay_report_lines(person, out), *lines]
    shown += [f"measured and predicted sensors: {out / imu_comparison.FILE}"] if compared else []
    return ReplayResult(tuple(shown))
