__version__: str

from .pretrained import load as load
