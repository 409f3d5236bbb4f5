"""What labels are called: in the header of their volume, or in a table of colours beside it."""

import csv
import html
import json
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

#: Connectome Workbench and TotalSegmentator write `<Label Key="5" ...><![CDATA[liver]]></Label>` into NIfTI.
_XML = re.compile(r"<Label\b([^>]*)>\s*(?:<!\[CDATA\[(.*?)\]\]>|([^<]*))\s*</Label>", re.DOTALL)
_KEY = re.compile(r"\bKey\s*=\s*[\"']\s*(\d+)\s*[\"']")
#: 3D Slicer writes `Segment0_LabelValue:=5` and `Segment0_Name:=liver` into NRRD.
_SEGMENT = re.compile(r"^(\S+?)_(LabelValue|Name):=(.*)$")
#: Lines of tables: of ITK-SnAP, `5 255 0 0 1 1 1 "liver"`, and of 3D Slicer and FreeSurfer, `5 liver 255 0 0 255`.
_LINES = (
    re.compile(r"^\s*(?P<number>\d+)(?:\s+\d+){3}\s+[\d.]+\s+[01]\s+[01]\s+\"(?P<name>[^\"]*)\"\s*$"),
    re.compile(r"^\s*(?P<number>\d+)\s+(?P<name>\S*[^\W\d]\S*)(?:\s+\d+){4}\s*$"),
)
#: Columns; one that is called `label` may hold either.
_NUMBERS = ("labelvalue", "labelid", "label", "index", "value", "id")
_NAMES = ("name", "labelname", "structurename", "structure", "organ", "label")
_TABLES = (".txt", ".label", ".ctbl", ".csv", ".tsv", ".json")
_MOST_BYTES = 2**20  # of a table; what is longer is none


def names_in_header(path: Path) -> dict[int, str]:
    """The names of labels that stand in the file itself; none where it has none, or cannot be read."""
    try:
        text = _nrrd_header(path) if path.suffix.lower() == ".nrrd" else _nifti_extensions(path)
    except Exception:  # every reader raises its own, and says so where the header is checked
        return {}
    if path.suffix.lower() == ".nrrd":
        found: dict[str, dict[str, str]] = {}
        for match in filter(None, map(_SEGMENT.match, text.splitlines())):
            found.setdefault(match[1], {})[match[2]] = match[3]
        pairs = [(one.get("LabelValue", ""), one.get("Name", "")) for one in found.values()]
    else:
        keys = ((_KEY.search(label[1]), label[2] or html.unescape(label[3] or "")) for label in _XML.finditer(text))
        pairs = [(key[1], name) for key, name in keys if key]
    return _checked(pairs)


def names_beside(path: Path, numbers: Collection[int]) -> tuple[dict[int, str], str]:
    """Names in a table beside a volume that has one for each of its labels, and the name of this file.

    A table that is called as the volume comes before others. Nothing where there is no such table.
    """
    stem = path.name.lower().split(".")[0]
    for table in sorted(tables_beside(path), key=lambda file: not file.name.lower().startswith(stem)):
        if table.stat().st_size <= _MOST_BYTES and set(numbers) - {0} <= (names := _names_in_table(table)).keys():
            return names, table.name
    return {}, ""


def tables_beside(path: Path) -> list[Path]:
    """The files beside a volume that may be tables of names, by their endings."""
    return [file for file in sorted(path.parent.iterdir()) if file.suffix.lower() in _TABLES and file.is_file()]


def _checked(pairs: Any) -> dict[int, str]:
    """Numbers and names as a mapping, in one line each; the background, and what has no name, are left out."""
    named = ((str(number).strip(), " ".join(str(name).split())) for number, name in pairs)
    return {int(number): name for number, name in named if number.isdecimal() and int(number) and name}


def _nifti_extensions(path: Path) -> str:
    import nibabel

    image: Any = nibabel.load(path)
    extensions = getattr(image.header, "extensions", ())
    contents = [e.content if hasattr(e, "content") else e.get_content() for e in extensions]  # as nibabel has it
    return "\n".join(c.decode("utf-8", "replace") if isinstance(c, bytes) else str(c) for c in contents)


def _nrrd_header(path: Path) -> str:
    """The header in UTF-8, as 3D Slicer writes it; pynrrd drops what is not ASCII."""
    lines = []
    with path.open("rb") as stream:
        while line := stream.readline(_MOST_BYTES).strip():
            lines.append(line.decode("utf-8", "replace"))
    return "\n".join(lines)


def _names_in_table(path: Path) -> dict[int, str]:
    """The names that a table gives to labels; none where it is another kind of file."""
    text = path.read_bytes().decode("utf-8-sig", "replace")
    if path.suffix.lower() == ".json":
        return _names_of_nnunet(text)
    if path.suffix.lower() in (".csv", ".tsv"):
        return _names_in_columns(text.splitlines())
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    for pattern in _LINES:
        if lines and all(matches := [pattern.match(line) for line in lines]):
            return _checked((match["number"], match["name"].replace("_", " ")) for match in matches if match)
    return {}


def _names_in_columns(lines: list[str]) -> dict[int, str]:
    """Those of a table with a header, between commas, tabs or semicolons, as spreadsheets of many countries have it."""
    separator = max(",;\t", key=lines[0].count) if lines else ","
    try:
        rows = list(csv.DictReader(lines, delimiter=separator))
    except csv.Error:  # another kind of file
        return {}
    columns = {re.sub(r"[^a-z]", "", column.lower()): column for column in rows[0] if column} if rows else {}
    held = {known: [row[column] or "" for row in rows] for known, column in columns.items()}
    numbers = next((c for c in _NUMBERS if any(cell.strip().isdecimal() for cell in held.get(c, ()))), None)
    names = next((c for c in _NAMES if c in held and c != numbers), None)
    return _checked(zip(held[numbers], held[names], strict=True)) if numbers and names else {}


def _names_of_nnunet(text: str) -> dict[int, str]:
    """The labels of a dataset.json, `{"liver": 1}`, or `{"1": "liver"}` as its first version had them."""
    try:
        labels = json.loads(text).get("labels", {})
    except (ValueError, AttributeError, RecursionError):
        return {}
    if not isinstance(labels, Mapping):
        return {}
    return _checked((k, v) if str(k).isdecimal() else (v, k) for k, v in labels.items())
