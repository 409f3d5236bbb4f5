"""Values of a `scene.yaml`, each checked: what is wrong is one line that names the key and what is allowed."""

import difflib
import math
from collections.abc import Hashable, Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml

from ablate.anatomy.site_grid import MOST_POSES
from ablate.anatomy.tissue import Tissue
from ablate.validation import shown

MOST_BYTES = 2**18  # of a scene.yaml: thousands of structures


def read_yaml(path: Path) -> Any:
    """The content of a YAML file; a ValueError names the file."""
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path}: has {path.stat().st_size} bytes; allowed are at most {MOST_BYTES}")
    try:
        return yaml.load(path.read_text(encoding="utf-8"), _Loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # a number or a date may be a ValueError
        raise ValueError(f"{path}: not readable as YAML: {' '.join(str(error).split())}") from None


class _Loader(yaml.SafeLoader):
    """YAML that refuses what goes wrong without a word.

    A key given twice would drop the first one; aliases can make a few hundred bytes stand for gigabytes.
    """

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            event = self.get_event()
            raise yaml.composer.ComposerError(None, None, "aliases (*) are not allowed", event.start_mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                raise yaml.constructor.ConstructorError(None, None, f"{key.value!r} is given twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def mapping(value: Any, where: str, allowed: tuple[str, ...]) -> Mapping[str, Any]:
    """The value, if it is a mapping whose keys are all allowed."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{where}: must be a mapping of {', '.join(allowed)}, not {shown(value)}")
    for key in value:
        if key not in allowed:
            hint = closest(key, allowed)
            raise ValueError(f"{where}: unknown key {shown(key)}{hint}; allowed: {', '.join(allowed)}")
    return value


def closest(name: object, known: Iterable[str]) -> str:
    """What may have been meant, for a message; empty where nothing is near."""
    close = difflib.get_close_matches(name[:100], list(known), n=3) if isinstance(name, str) else ()
    return f" (did you mean {' or '.join(close)}?)" if close else ""


def tissue_named(name: Any, tissues: Mapping[str, Tissue], where: str) -> Tissue:
    """The tissue of a name."""
    if not isinstance(name, str) or name not in tissues:
        raise ValueError(f"{where}: unknown tissue {shown(name)}{closest(name, tissues)}; known: {', '.join(tissues)}")
    return tissues[name]


def series(value: Any, where: str) -> tuple[float, ...]:
    """A list of numbers, one number, or {range: [first, last], count: n}."""
    if isinstance(value, Mapping):
        value = mapping(value, where, ("range", "count"))
        first, last = numbers(value.get("range"), f"{where}.range", 2)
        count = value.get("count")
        if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST_POSES:
            raise ValueError(f"{where}.count: must be a whole number from 1 to {MOST_POSES}, not {shown(count)}")
        step = (last - first) / max(count - 1, 1)
        return tuple(first + i * step for i in range(count))
    return numbers(value if isinstance(value, list) else [value], where)


def numbers(value: Any, where: str, count: int | None = None) -> tuple[float, ...]:
    """A list of numbers, of `count` if that is given."""
    if not isinstance(value, (list, tuple)) or (count is not None and len(value) != count):
        expected = "numbers" if count is None else f"{count} numbers"
        raise ValueError(f"{where}: must be a list of {expected}, not {shown(value)}")
    return tuple(number(item, where) for item in value)


def number(value: Any, where: str) -> float:
    """A finite number."""
    try:
        if not isinstance(value, bool) and isinstance(value, (int, float)) and math.isfinite(found := float(value)):
            return found
    except OverflowError:
        pass
    raise ValueError(f"{where}: must be a finite number, not {shown(value)}")
