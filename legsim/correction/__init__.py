"""Methods that find or undo the motion of a scan, and the interface for a user's own."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
