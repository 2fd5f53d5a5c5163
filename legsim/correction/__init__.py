"""Methods that find or undo the motion of a scan, and the seam behind which one's own competes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
