"""What torch runs, counted."""

from collections import Counter
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode


class Operations(TorchDispatchMode):
    """Counts every operation that torch runs within it, the types of its first operand, and a convolution's inputs."""

    def __init__(self) -> None:
        super().__init__()
        self.counts: Counter[str] = Counter()
        self.dtypes: dict[str, set[torch.dtype]] = {}
        self.channels = 0

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = function.overloadpacket.__name__
        self.counts[name] += 1
        if args and isinstance(args[0], Tensor):
            self.dtypes.setdefault(name, set()).add(args[0].dtype)
            self.channels += args[0].shape[1] if name == "convolution" else 0
        return function(*args, **(kwargs or {}))
