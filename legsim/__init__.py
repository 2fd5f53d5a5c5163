"""legsim: a weight-bearing knee CT simulated from motion capture, and its motion corrected by
inertial measurements.
"""

import importlib.metadata

__version__ = importlib.metadata.version("legsim")
