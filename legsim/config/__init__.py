"""The settings of a run: one frozen tree, in mm and degrees, read strictly from TOML."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
