"""Monte-Carlo ray tracing of B-mode frames, with the label and attenuation maps that go with them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
