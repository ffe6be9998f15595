"""A library of shapes on disk or in object storage that answers which of them are most like another."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
