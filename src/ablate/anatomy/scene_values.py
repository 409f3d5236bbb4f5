"""Values of a `scene.yaml`, each checked: what is wrong is one line that names file, key, value and what is allowed.

`where` is the file and the key of a value, as it stands in the message.
"""

import csv
import difflib
import os
import re
import sys
from collections.abc import Collection, Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any
from unicodedata import normalize

import yaml

from ablate.anatomy.site_grid import MOST_POSES
from ablate.setting import naming, shown

_MOST_MERGED = 1000  # keys of other mappings, by `<<`; ten lines of aliases can ask for as many as memory holds


def read_yaml(path: Path) -> Any:
    """The content of a YAML file; a ValueError names the file."""
    # a number or a date may be a ValueError
    with naming(f"{path}: not readable as YAML: ", (yaml.YAMLError, ValueError, RecursionError)):
        return yaml.load(path.read_text(encoding="utf-8"), _Loader)


def csv_rows(path: Path, needed: Sequence[str], optional: Sequence[str] = ()) -> list[tuple[str, dict[str, str]]]:
    """Places, for messages, and rows of a CSV file with a header line; values without blanks around them, in NFC."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream, skipinitialspace=True)
            columns = reader.fieldnames = [column.strip() for column in reader.fieldnames or ()]
            stripped = ({k: normalize("NFC", v or "").strip() for k, v in row.items() if k} for row in reader)
            rows = [(f"{path}, line {reader.line_num}", row) for row in stripped]
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not readable as CSV in UTF-8 ({error})") from error
    if not set(needed) <= set(columns) <= {*needed, *optional} or len(set(columns)) < len(columns):
        also = f" and, if wanted, {', '.join(optional)}" if optional else ""
        raise ValueError(f"{path}: its first line must be {','.join(needed)}{also}, not {','.join(columns) or 'empty'}")
    return rows


class _Loader(yaml.SafeLoader):
    """YAML that refuses a key given twice, which would drop the first one without a word, and merges that grow."""

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        given = len(node.value)
        super().flatten_mapping(node)  # of what is merged first, so that each level is bounded before the next
        if len(node.value) > given + _MOST_MERGED:
            raise yaml.constructor.ConstructorError(
                None, None, f"more than {_MOST_MERGED} keys are merged by <<", node.start_mark
            )

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                raise yaml.constructor.ConstructorError(None, None, f"{key.value!r} is given twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


# Numbers as YAML 1.2 has them: 1e-3 is one, 010 is ten, and 1:30 is none.
_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith((":int", ":float"))]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _tag, _pattern in {
    "int": r"[-+]?(0|[1-9]\d*)$",
    "float": r"[-+]?((\.\d+|\d+(\.\d*)?)([eE][-+]?\d+)?|\.(inf|Inf|INF))$|\.(nan|NaN|NAN)$",
}.items():
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(_pattern), list("-+.0123456789"))


def refusal(where: str, value: object, allowed: str) -> ValueError:
    """The error that says what is allowed instead of a value."""
    return ValueError(f"{where}={shown(value)}: allowed are {allowed}")


def one_of(value: Any, names: Collection[str], where: str) -> str:
    """The value, if it is one of the names; a refusal lists them all, and the similar ones first."""
    if isinstance(value, str) and value in names:
        return value
    close = difflib.get_close_matches(value[:100], names, n=3) if isinstance(value, str) else []
    hint = f" (did you mean {' or '.join(close)}?)" if close else ""
    raise ValueError(f"{where}={shown(value)}{hint}: allowed are {', '.join(names)}")


def mapping(value: Any, where: str, keys: Collection[str]) -> Mapping[str, Any]:
    """The value, if it is a mapping and all its keys are allowed."""
    if not isinstance(value, Mapping):
        raise refusal(where, value, f"mappings of {', '.join(keys)}")
    for key in value:
        one_of(key, keys, f"{where}: key")
    return value


def file_named(name: Any, suffixes: tuple[str, ...], folder: Path, where: str) -> Path:
    """The file of this name within the folder of the `scene.yaml`.

    Parameters
    ----------
    name : object
        What stands in the file.
    suffixes : tuple of str
        Endings that are allowed.
    folder : Path
        That of the `scene.yaml`.
    where : str
        The key, for messages.

    Raises
    ------
    FileNotFoundError
        When it is not there.
    ValueError
        When it is no name, ends otherwise or lies elsewhere.
    """
    if not isinstance(name, str) or not name.lower().endswith(suffixes):
        raise refusal(where, name, f"names of files that end in {', '.join(suffixes)}")
    if not os.path.isfile(folder / name):  # noqa: PTH113, it is False for a name that is too long
        raise FileNotFoundError(f"{where}: no file {shown(name)} in {folder}")
    check_within(folder, folder / name, where)
    return folder / name


def check_within(folder: Path, path: Path, where: str) -> None:
    """Refuse a file that a file of the folder names and that lies elsewhere, also where a link leads out."""
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"{where}: {shown(path.name)} does not lie in {folder}; allowed are files within it")


def series(value: Any, where: str) -> tuple[float, ...]:
    """Numbers given as a list, as one number, or as {range: [first, last], count: n}."""
    if isinstance(value, Mapping):
        value = mapping(value, where, ("range", "count"))
        first, last = numbers(value.get("range"), f"{where}.range", 2)
        count = value.get("count")
        if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST_POSES:
            raise refusal(f"{where}.count", count, f"whole numbers from 1 to {MOST_POSES}")
        step = (last - first) / max(count - 1, 1)
        return tuple(first + i * step for i in range(count))
    return numbers(value if isinstance(value, list) else [value], where)


def numbers(value: Any, where: str, count: int | None = None) -> tuple[float, ...]:
    """A list of numbers as a tuple; the list must have `count` numbers, where that is given."""
    if not isinstance(value, (list, tuple)) or (count is not None and len(value) != count):
        raise refusal(where, value, "lists of numbers" if count is None else f"lists of {count} numbers")
    return tuple(number(item, where) for item in value)


def number(value: Any, where: str) -> float:
    """The value as a float, if it is a number and finite."""
    if isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max:
        return float(value)
    raise refusal(where, value, "finite numbers")
