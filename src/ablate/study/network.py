"""The network of a training, with all that it needs to render: what `ablate.load` reads."""

from dataclasses import replace

from ablate.dataset import label_values
from ablate.pretrained import Renderer, values_of
from ablate.study.training import Training
from ablate.training import load_generator


def renderer_of(training: Training) -> Renderer:
    """The generator of a training, with the setting that it was trained in; its data set is read.

    A network of a user's own is a ValueError, as its class is not named here.
    """
    s, tissues = training.settings, training.data_set.tissues
    values = label_values(tissues, s.encoding, s.label_seed)
    made = {"study": s.study, "variant": training.label, "seed": str(training.seed), "hash": training.hash}
    made["commit"] = str(training.made_with.get("git_commit", ""))
    simulator = replace(s.simulator, time_gain_db=training.data_set.time_gain_db)
    return Renderer(load_generator(training.checkpoint), values_of(tissues, values), s.probe, simulator, made)
