"""Figures for reports: dark text on white, units on every axis.

They are made without a screen and without pyplot's global state.
"""

import lazy_loader

# the names of the stub next to this file, each loaded at first use
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
