"""legsim: weight-bearing knee CT simulated from motion capture, its motion corrected by sensors.

>>> import legsim as ls
>>> person = ls.solve_kinematics("subject01/squat_60.trc")
>>> scan = ls.simulate_scan(person, ls.CArm.half())
>>> volume = ls.fdk(ls.Rigid("shank_l")(scan.seen), scan.grid())
"""

import importlib.metadata

import lazy_loader

__version__ = importlib.metadata.version("legsim")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
