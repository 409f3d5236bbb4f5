"""Paired statistics, effects, tables, figures and the report; from data frames to files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
