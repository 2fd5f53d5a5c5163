"""How still the ankles of people who stand are: `python -m tools.experiments.still_ankles FILES`.

For docs/fusion.md. Of every recording of two seconds or more and every ankle in it that stays
within a centimeter through its calmest eight seconds: the RMS step of a coordinate between moments
a fifth of a second, half a second and a second apart. The ankle is the mean of the malleoli that
are marked, so that cameras' noise and skin are in it. Copies count once. Files that cannot be
read, and recordings without malleoli, are passed over and counted.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from legsim.core.errors import LegsimError
from legsim.core.files import sha256
from legsim.core.values import FloatArray
from legsim.mocap import marker_sets
from legsim.mocap.files import load_markers
from legsim.mocap.trajectories import MarkerTrajectories

APART_S = (0.2, 0.5, 1.0)
LONGEST_S, SHORTEST_S = 8.0, 2.0
STAYS = 0.01
"""m"""
SEEN = 0.9
"""of the frames"""
REQUIRED = ("malleolus_lateral_r", "malleolus_lateral_l")


def ankles(markers: MarkerTrajectories) -> dict[str, FloatArray]:
    """Side to the (n, 3) m of its ankle, NaN where unseen.

    Raises:
        LegsimError: no malleoli are known.
    """
    found = marker_sets.guess(markers.marker_names, required=REQUIRED).found_in(
        markers.marker_names
    )
    paths = {}
    for side in "rl":
        roles = [r for r in (f"malleolus_lateral_{side}", f"malleolus_medial_{side}") if r in found]
        labels = [markers.marker_names.index(name) for role in roles for name in found[role]]
        paths[side] = markers.positions_world[:, labels].mean(1)
    return paths


def calmest(times: FloatArray, at: FloatArray) -> FloatArray | None:
    """The eight seconds (k, 3), or all there is, through which points (n, 3) move least; None where
    they do not stay, are seldom seen, or are too few.
    """
    seen = np.isfinite(at).all(-1)
    if seen.mean() < SEEN or times[-1] - times[0] < SHORTEST_S:
        return None
    whole = np.stack([np.interp(times, times[seen], axis[seen]) for axis in at.T], -1)
    count = min(len(times), 1 + round(LONGEST_S * (len(times) - 1) / (times[-1] - times[0])))
    parts = [
        whole[first : first + count]
        for first in range(0, len(times) - count + 1, max(1, count // 4))
    ]
    part = min(parts, key=lambda p: float(np.ptp(p, axis=0).max()))
    return part if np.ptp(part, axis=0).max() < STAYS else None


def steps(at: FloatArray, apart: int) -> float:
    """RMS of a coordinate's step between samples (n, 3) that are so many ``apart``."""
    return float(np.sqrt(np.square(at[apart:] - at[:-apart]).mean()))


def main(files: Annotated[list[Path], typer.Argument(exists=True)]) -> None:
    """Prints a row for each ankle and quartiles of all."""
    found, passed_over = [], 0
    distinct = {sha256(file): file for file in files}.values()
    for file in distinct:
        try:
            markers = load_markers(file)
            paths = ankles(markers)
        except LegsimError:
            passed_over += 1
            continue
        for side, path in paths.items():
            at = calmest(markers.times, path)
            if at is None:
                continue
            row = [1e3 * steps(at, max(1, round(s * markers.rate_hz))) for s in APART_S]
            seconds = (len(at) - 1) / markers.rate_hz
            print(f"{file.name} {side} {seconds:.1f} s:", *(f"{size:.3f}" for size in row), "mm")
            found.append(row)
    print(f"{len(found)} ankles; {passed_over} of {len(distinct)} files passed over")
    if not found:
        return
    for apart, sizes in zip(APART_S, np.transpose(found), strict=True):
        quartiles = ", ".join(f"{q:.3f}" for q in np.percentile(sizes, [10, 25, 50, 75, 90]))
        print(f"{apart:g} s apart: {quartiles} mm (10, 25, 50, 75, 90 %)")


if __name__ == "__main__":
    typer.run(main)
