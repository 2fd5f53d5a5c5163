from .comparison import Comparison as Comparison
from .comparison import compare as compare
from .setup import PhantomOptions as PhantomOptions
from .setup import ScanSetup as ScanSetup
from .simulated_scan import ScanTruth as ScanTruth
from .simulated_scan import SimulatedScan as SimulatedScan
from .simulated_scan import simulate_scan as simulate_scan
