"""Recordings read back by rerun's own tools."""

import subprocess
import sys

import numpy as np
import rerun.chunk as rc


def read(path, entity, component, timeline="time"):
    """(times (n,) in s or frames, one array a row) of a logged component, in the order of the
    timeline.
    """
    times, values = [], []
    for chunk in rc.RrdReader(path).store().stream().filter(content=entity).to_chunks():
        batch = chunk.to_record_batch()
        if chunk.entity_path != entity or component not in batch.schema.names:
            continue
        values += batch.column(component).to_pylist()
        if not chunk.is_static:
            times.append(batch.column(timeline).to_numpy(zero_copy_only=False))
    if not times:
        return None, [np.array(v) for v in values]
    times = np.concatenate(times)
    order = np.argsort(times, kind="stable")
    seconds = times[order] / np.timedelta64(1, "s") if timeline == "time" else times[order]
    return seconds, [np.array(values[i]) for i in order]


def rrd(*arguments):
    """Runs rerun's file tool."""
    return subprocess.run(
        [sys.executable, "-m", "rerun_cli", "rrd", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )
