"""The six components of the paper's study as values, with the metrics and bands of its first study."""

from ablate.analysis import Component

# fmt: off
COMPONENTS = (
    Component("att", "model.attenuation", "integral", "none", "attenuation map", "", "shadow_contrast", 3.0),
    Component("concat", "model.concat", "every_level", "input", "maps at every level", "", "thin_contrast", 2.5),
    Component("conv", "model.upsampling", "texture", "transposed", "texture-friendly up-sampling", "",
              "nyquist_excess", 0.4),
    Component("noise", "model.noise", "inject", "input", "noise at every resolution", "", "crps", 0.8),
    Component("depth", "model.depth", 4, 8, "small receptive field", "", "mae_smooth", 1.0),
    Component("encoding", "encoding", "echogenicity", "arbitrary", "order of the labels", "", "mae_smooth", 1.0),
)
# fmt: on
FULL = {component.key: component.on for component in COMPONENTS}


def without(*names: str) -> dict[str, object]:
    """What the full model is made from, with some components off: the level of every component by its key."""
    return FULL | {component.key: component.off for component in COMPONENTS if component.name in names}
