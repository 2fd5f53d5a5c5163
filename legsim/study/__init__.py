"""Many scans: subjects x postures x methods x noise, with tables beside the published ones."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
