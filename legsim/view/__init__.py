"""Recordings for the rerun viewer: one .rrd a run, which opens with all of it in view."""

import lazy_loader

# what the stub beside this file names, each loaded when it is first asked for
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
