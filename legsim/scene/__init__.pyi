from .values import ReplayScene as ReplayScene
from .values import ScanScene as ScanScene
