from .method import Correction as Correction
from .method import CorrectionMethod as CorrectionMethod
from .method import Scan as Scan
from .rigid import rigid_motion as rigid_motion
from .rigid import sensor_path as sensor_path
