from .run_scores import resimulation_images as resimulation_images
from .run_scores import score_run as score_run
from .scorer import ImageSource as ImageSource
from .scorer import Scorer as Scorer
from .scorer import Scores as Scores
from .scorer import describes_fan as describes_fan
from .scorer import tissue_labels as tissue_labels
from .settings import EvaluationSettings as EvaluationSettings
