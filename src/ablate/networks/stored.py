"""Networks from files that anybody may have made: nothing in them runs code, and none takes more memory than its size.

A specification of a few bytes can name a network of terabytes. Sizes are compared before anything is allocated.
"""

import pickletools
import re
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import torch
from torch import Tensor

from ablate.networks.generator import Generator
from ablate.networks.spec import Family, GeneratorSpec
from ablate.storage import check_archive

MOST_LABELS = 256  # channels of a segmentation, whose labels are uint8
# What torch lets a file call that is given a size in place of content, by module and name.
_MAKERS_OF_A_SIZE = re.compile(r"\w*builtin\w* bytearray|torch(\.\w+)* (\w*Tensor|UntypedStorage|TypedStorage)")


def read_stored(path: Path) -> Any:
    """Read what `torch.save` wrote, on the CPU, with `weights_only=True`.

    A ValueError names the file where it would take more memory than its size; torch raises its own for what is damaged.
    """
    check_archive(path)
    with path.open("rb") as stream:
        if stream.read(4) != b"PK\x03\x04":  # torch then takes it for a file of its first versions
            raise ValueError(f"{path}: does not begin as an archive")
    check_calls(path)
    return torch.load(path, map_location="cpu", weights_only=True)


def check_calls(file: Path | BytesIO) -> None:
    """Refuse what `torch.save` wrote where reading it would make something of a size that only a number says.

    It is a ValueError that names what would be called.
    """
    with ZipFile(file) as archive:
        for name in archive.namelist():
            operations = pickletools.genops(archive.read(name)) if name.endswith(".pkl") else ()
            for _, called, _ in operations:
                if _MAKERS_OF_A_SIZE.fullmatch(str(called)):
                    raise ValueError(f"{name} calls {called}; allowed are tensors, numbers, text, lists and dicts")


def stored_generator(spec: GeneratorSpec, labels: int, weights: Mapping[str, Any]) -> Generator:
    """A generator, on the CPU, with weights that a file holds.

    Parameters
    ----------
    spec, labels : GeneratorSpec, int
        As of `Generator`; a class of a user's own is made, which is to be known by then.
    weights : mapping of str to Tensor
        Its `state_dict`.

    Raises
    ------
    ValueError
        Where a weight is missing or has another shape, or the file holds fewer numbers than the weights have. It names
        the weight; nothing has been allocated then.
    RuntimeError
        Where the file has further weights.
    """
    if labels not in range(1, MOST_LABELS + 1):
        raise ValueError(f"labels={labels!r:.40}: allowed are 1 to {MOST_LABELS}")
    if spec.family is Family.custom:
        with torch.random.fork_rng():
            generator = Generator(spec, labels)
    else:
        with torch.device("meta"):
            generator = Generator(spec, labels)
        _check_sizes(generator, weights)
        generator.to_empty(device="cpu")
    generator.load_state_dict(weights)
    return generator


def _check_sizes(generator: Generator, weights: Mapping[str, Any]) -> None:
    """Compare the weights of a generator that has sizes and no values with those of a file."""
    held: dict[int, int] = {}  # bytes by place in memory: several weights, or all numbers of one, may share one
    needed = 0
    for name, expected in generator.state_dict().items():
        weight = weights.get(name)
        if not isinstance(weight, Tensor) or weight.layout is not torch.strided or weight.device.type != "cpu":
            raise ValueError(f"{name}: is no tensor")
        if weight.shape != expected.shape:
            raise ValueError(f"{name}: {tuple(weight.shape)} is stored, allowed is {tuple(expected.shape)}")
        held[weight.untyped_storage().data_ptr()] = weight.untyped_storage().nbytes()
        needed += weight.nbytes
        if needed > sum(held.values()):
            raise ValueError(f"{name}: the file holds fewer numbers than its shape, {tuple(weight.shape)}")
