"""One scan from recording to report, in a folder that keeps finished stages."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
