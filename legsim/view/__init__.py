"""Recordings for the rerun viewer: one .rrd per run, which opens with a layout of its own."""

import lazy_loader

# the names of the stub next to this file, each loaded at first use
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
