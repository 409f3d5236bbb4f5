__version__: str

from .pretrained import load as load
from .study.opened import open_study as open_study
