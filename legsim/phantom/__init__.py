"""The scanned object: closed meshes of materials that move with the leg."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
