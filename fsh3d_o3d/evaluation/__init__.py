"""How well a descriptor retrieves: classifications, metrics of the Princeton benchmark, re-ranking by neighbours."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
