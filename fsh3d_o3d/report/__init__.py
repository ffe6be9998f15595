"""Pictures and pages of results: thumbnails without a graphics card, HTML that works offline."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
