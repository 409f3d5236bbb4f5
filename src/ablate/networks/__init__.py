"""Generators composed of the components that an ablation switches, and their discriminator."""

from ablate.networks.discriminator import PatchDiscriminator, discriminator_channels
from ablate.networks.export import export_onnx
from ablate.networks.gaussian_fields import gaussian_field
from ablate.networks.generator import Generator
from ablate.networks.parameters import count_discriminator, count_generator, count_parameters
from ablate.networks.receptive_field import patch_size, receptive_field
from ablate.networks.spec import (
    Attenuation,
    Concat,
    ExtraInput,
    Family,
    GeneratorSpec,
    Noise,
    Upsampling,
    conditions,
    draws_noise,
    inputs,
)

__all__ = [
    "Attenuation",
    "Concat",
    "ExtraInput",
    "Family",
    "Generator",
    "GeneratorSpec",
    "Noise",
    "PatchDiscriminator",
    "Upsampling",
    "conditions",
    "count_discriminator",
    "count_generator",
    "count_parameters",
    "discriminator_channels",
    "draws_noise",
    "export_onnx",
    "gaussian_field",
    "inputs",
    "patch_size",
    "receptive_field",
]
