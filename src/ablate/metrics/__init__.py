"""PSNR, MAE, patch chi-square, Frechet and kernel distance, and the metrics of mechanism."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
