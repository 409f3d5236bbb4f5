from .other_settings import trained_with as trained_with
from .renderer import NAMES as NAMES
from .renderer import OUTSIDE as OUTSIDE
from .renderer import Renderer as Renderer
from .renderer import load as load
from .renderer import save as save
from .renderer import values_of as values_of
