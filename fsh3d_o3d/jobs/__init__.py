"""The same work for many files: worker processes that may die, Ray, and a cache of descriptors."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
