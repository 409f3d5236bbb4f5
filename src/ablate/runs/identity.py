"""The identity of a run: the settings that decide its result. No folder may mix two of them."""

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from ablate.dataset import PAIRS_VERSION
from ablate.dataset.encoding import Encoding
from ablate.runs.imported import about_imported
from ablate.setting import identity
from ablate.settings.study import SceneKind, StudySettings
from ablate.training.settings import TRAINING_VERSION, TrainingPrecision, TrainingSettings
from ablate.user_code import source_digest

#: The keys of `semantic` in which the runs of one study may differ besides what their labels say.
_OF_A_RUN = frozenset({"seed", "training.seed", "training.loss", "data.scene.anatomy_seed"})
_OF_THE_DATA = ("scene", "probe", "simulator", "dataset")


def semantic(settings: StudySettings) -> dict[str, Any]:
    """The settings that decide the trained network and its scores, as JSON values.

    A network of the user's has the digest of its code. Where files decide, as of a scene folder, they are read.
    """
    target = settings.model.target
    order = {"order": settings.encoding.name}
    return {
        "data": about_data(settings),
        "encoding": order | ({"seed": settings.encoding_seed} if settings.encoding is Encoding.arbitrary else {}),
        "model": identity(settings.model) | ({"source": source_digest(target)} if target else {}),
        "training": identity(settings.training) | {"precision": precision_of(settings.training).name},
        "training_version": TRAINING_VERSION,
        "evaluation": identity(settings.evaluation),
        "crops": identity(settings.crops),
        "seed": settings.seed,
    }


def about_data(settings: StudySettings) -> dict[str, Any]:
    """What every pair of the data set is made from, as JSON values."""
    if settings.scene.kind is SceneKind.pairs:
        about = about_imported(settings)
    else:
        from ablate.runs.simulated import about_simulated  # loads Embree and numba

        about = about_simulated(settings)
    return {**about, "pairs_version": PAIRS_VERSION}


def precision_of(training: TrainingSettings) -> TrainingPrecision:
    """The precision that a training has on this machine: `auto` depends on the device."""
    if training.precision is not TrainingPrecision.auto:
        return training.precision
    from ablate.training import chosen_device, chosen_precision  # loads PyTorch

    return chosen_precision(training.precision, chosen_device(training.device))


def differences(a: Any, b: Any, key: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Dotted keys in which two nested dicts differ, with the value of each; None where one has none."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for k in sorted(a.keys() | b.keys()):
            yield from differences(a.get(k), b.get(k), f"{key}.{k}".lstrip("."))
    elif a != b:
        yield key, a, b


def not_shared(a: Mapping[str, Any], b: Mapping[str, Any], labelled: Collection[str]) -> list[tuple[str, Any, Any]]:
    """What differs between two runs of one study, given by `semantic`, and should not.

    The runs of a study share pairs, training, crops, evaluation and width. They may differ in what their labels tell
    apart: network, encoding, seed, adversarial loss, anatomy, and the configuration keys `labelled`.
    """
    if "preset" in labelled:
        return []
    own = tuple(semantic_key(key) for key in labelled)

    def is_told(key: str) -> bool:
        return (
            key in _OF_A_RUN
            or key.startswith("encoding")
            or (key.startswith("model.") and key != "model.width")
            or any(key == one or key.startswith(f"{one}.") for one in own)
        )

    return [difference for difference in differences(a, b) if not is_told(difference[0])]


def semantic_key(key: str) -> str:
    """The key of `semantic` that a key of the command line decides, such as `data.dataset.frames`."""
    return f"data.{key}" if key.partition(".")[0] in _OF_THE_DATA else key
