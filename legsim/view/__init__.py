"""Recordings for the rerun viewer: one .rrd a run, which opens with all of it in view."""

from legsim.view.recording import write_replay as write_replay
from legsim.view.recording import write_scan as write_scan
from legsim.view.window import open_viewer as open_viewer
from legsim.view.window import screenshot as screenshot
