from .cleaning import clean as clean
from .files import load_recording as load_recording
from .files import save_recording as save_recording
from .raw import RawMarkers as RawMarkers
from .trajectories import JointTrajectories as JointTrajectories
from .trajectories import MarkerTrajectories as MarkerTrajectories
