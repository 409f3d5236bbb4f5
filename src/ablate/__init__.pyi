__version__: str

from .comparison.reading import open_study as open_study
from .pretrained import load as load
