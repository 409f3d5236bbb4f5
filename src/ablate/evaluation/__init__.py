"""A generator on frames that it has never seen: scores of frames, and of whole sets of frames."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
