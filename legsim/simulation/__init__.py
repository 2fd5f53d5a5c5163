"""One simulated scan as a value: the input of methods, the scan at rest, the truth."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
