from .recording import write_measured as write_measured
from .recording import write_replay as write_replay
from .recording import write_scan as write_scan
from .window import open_viewer as open_viewer
from .window import screenshot as screenshot
