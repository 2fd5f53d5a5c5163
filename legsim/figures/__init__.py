"""Figures for reports: dark text on white, units on every axis, made without a screen and without
pyplot's global state.
"""

import lazy_loader

# what the stub beside this file names, each loaded when it is first asked for
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
