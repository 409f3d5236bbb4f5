__version__: str

from .comparison.opened import open_study as open_study
from .pretrained import load as load
