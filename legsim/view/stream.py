"""The rerun stream of one recording with its timelines.

The timelines are `time` (seconds) and `frame` (samples of the motion).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import rerun as rr

from legsim.core import transforms
from legsim.core.values import FloatArray


def entity_path(*parts: str) -> str:
    """Joins the parts of an entity's path; slashes and blanks in a name are the name's own."""
    return "/".join(rr.escape_entity_path_part(part) for part in parts)


@dataclass(frozen=True, slots=True, eq=False)
class Recorder:
    """Logs whole columns at once, on both timelines."""

    stream: rr.RecordingStream
    clock: FloatArray
    """(n,) s, the times of the motion's frames; other times take the nearest frame's number"""

    def columns(
        self, entity: str, times: FloatArray, columns: Iterable[rr.ComponentColumn]
    ) -> None:
        """Logs one row of ``columns`` per time (n,)."""
        middles = 0.5 * (self.clock[1:] + self.clock[:-1])
        frames = np.searchsorted(middles, times)
        self.stream.send_columns(
            entity,
            [rr.TimeColumn("time", duration=times), rr.TimeColumn("frame", sequence=frames)],
            columns,
        )

    def from_start(self, times: FloatArray) -> tuple[FloatArray, np.ndarray]:
        """Prepends the first row at the clock's start where it comes later.

        Returns (times, indices into the logged values). A scan begins within the motion; until then
        the C-arm waits at its first view, instead of missing from the picture.
        """
        rows = np.arange(len(times))
        if times[0] <= self.clock[0]:
            return times, rows
        return np.concatenate([self.clock[:1], times]), np.concatenate([rows[:1], rows])

    def static(self, entity: str, *content: rr.AsComponents) -> None:
        """Logs static content: styles, triangles, pictures that do not change."""
        self.stream.log(entity, *content, static=True)

    def poses(self, entity: str, times: FloatArray, world_from_entity: FloatArray) -> None:
        """Places an entity by (n, 4, 4) rigid transforms."""
        wxyz = transforms.quaternion_from_rotation(world_from_entity[:, :3, :3])
        xyzw = wxyz[:, [1, 2, 3, 0]]  # rerun's order
        self.columns(
            entity,
            times,
            rr.Transform3D.columns(translation=world_from_entity[:, :3, 3], quaternion=xyzw),
        )
