"""Ablation studies of ultrasound-rendering GANs on pairs from a Monte-Carlo ray-tracing simulator."""

import lazy_loader

__version__ = "0.1.0"  # the package's too: see pyproject.toml
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
