"""motions/README.md: what the recordings are, and a table of what they measure, computed from the
files themselves.
"""

from pathlib import Path

import numpy as np

from legsim.mocap import trc
from tools.virtual_subjects import sensors
from tools.virtual_subjects.plan import RATE
from tools.virtual_subjects.statistics import Sway, count_squats, knee_flexion_deg, load_truth, sway
from tools.virtual_subjects.subjects import SUBJECTS

HOLDS = ("squat_30", "squat_60")
MOTIONS = Path(__file__).parents[2] / "motions"
TEMPLATE = Path(__file__).with_name("readme.md")


def write_readme(folder: Path) -> None:
    """Writes README.md beside the subjects' folders."""
    text = TEMPLATE.read_text("utf-8")
    for name, rows in (
        ("people", people_table()),
        ("sway", sway_table(folder)),
        ("squats", squat_table(folder)),
        ("sensors", sensor_table(folder)),
    ):
        text = text.replace(f"<!-- {name} -->", "\n".join(rows))
    (folder / "README.md").write_text(text, "utf-8")


def people_table() -> list[str]:
    """Markdown rows of the seven people."""
    rows = [
        "| subject | sex | height | mass | thigh | shank | stance | toes out r, l | squats to |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for s in SUBJECTS:
        size = (
            f"{s.height:.2f} m | {s.mass:.1f} kg | {s.thigh[1]:.3f} | {s.shank[1]:.3f} | "
            f"{1e3 * s.stance_width:.0f} mm"
        )
        toes = f"{s.toe_out_deg[0]:.0f}°, {s.toe_out_deg[1]:.0f}°"
        rows.append(f"| {s.name} | {s.sex} | {size} | {toes} | {s.squat_depth_deg:.0f}° |")
    return rows


def sway_table(folder: Path) -> list[str]:
    """Markdown rows of all held squats, from the files."""
    columns = (
        "recording",
        "pelvis std x, y, z (mm)",
        "speed (mm/s)",
        "markers (mg)",
        "shank (deg/s)",
        "knees r, l (deg)",
        "std (deg)",
        "unseen",
    )
    rows = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    for subject in SUBJECTS:
        for trial in HOLDS:
            path = folder / subject.name / trial
            cells = _sway_cells(sway(trc.load(f"{path}.trc"), load_truth(f"{path}_truth.npz")))
            rows.append(f"| {subject.name}/{trial} | {' | '.join(cells)} |")
    return rows


def _sway_cells(s: Sway) -> list[str]:
    return [
        ", ".join(f"{x:.2f}" for x in s.pelvis_std_mm),
        f"{s.pelvis_speed_mm_s:.1f}",
        f"{s.marker_acceleration_mg.min():.1f}-{s.marker_acceleration_mg.max():.1f}",
        f"{s.shank_rate_deg_s[1]:.2f}",
        ", ".join(f"{x:.1f}" for x in s.knee_flexion_deg),
        ", ".join(f"{x:.2f}" for x in s.knee_flexion_std_deg),
        f"{s.missing_frames}",
    ]


def squat_table(folder: Path) -> list[str]:
    """Markdown rows of the active squats, from the truth."""
    rows = [
        "| recording | squats | knee flexion, least and most (deg) | fastest (deg/s) |",
        "|---|---|---|---|",
    ]
    for subject in SUBJECTS:
        flexion = knee_flexion_deg(load_truth(str(folder / subject.name / "squats_truth.npz")))
        fastest = np.abs(np.gradient(flexion, 1 / RATE)).max()
        rows.append(
            f"| {subject.name}/squats | {count_squats(flexion)} | {flexion.min():.0f}, "
            f"{flexion.max():.0f} | {fastest:.0f} |"
        )
    return rows


def sensor_table(folder: Path) -> list[str]:
    """Markdown rows of what sensors on the true bones read, beside a person's who stands."""
    columns = {"a person who stands": sensors.STANDING}
    for trial in HOLDS:
        paths = [folder / subject.name / f"{trial}_truth.npz" for subject in SUBJECTS]
        read = [sensors.on_bones(load_truth(str(path))) for path in paths]
        columns[trial] = {segment: sensors.spread(read, segment) for segment in sensors.STANDING}
    return sensors.table(columns)
