"""The tables beside a folder of PNGs: sites and parts of the frames, tissues of the labels, the fan."""

import re
from pathlib import Path

import numpy as np

from ablate.anatomy import Tissue, load_tissues
from ablate.anatomy.scene_values import csv_rows, mapping, one_of, read_yaml
from ablate.dataset.split import Part
from ablate.setting import naming, plain
from ablate.ultrasound.settings import PROBE_KEYS, Probe, probe_from

MOST_LABELS = 254  # they are counted in 8 bits, and 0 is outside the fan
#: What probes have, from those within the body and for the skin to those for a whole abdomen; no angle is in radians.
USUAL = {
    "radius_mm": (8, 120), "width_mm": (10, 120), "aperture_mm": (5, 60), "depth_mm": (20, 400), "fov_deg": (10, 180)
}  # fmt: skip


def sites_and_parts(path: Path, names: tuple[str, ...]) -> tuple[tuple[str, ...], np.ndarray | None]:
    """Site and part of every frame; without the table a site is what stands before the last `_` of a name."""
    if not path.exists():
        return tuple(name.rpartition("_")[0] or name for name in names), None
    known = set(names)
    rows: dict[str, dict[str, str]] = {}
    for where, row in csv_rows(path, ("name", "site"), ("part",)):
        name = row["name"]
        if name not in known:  # with the ending of its file, in whatever case
            name = re.sub(r"\.png$", "", name, flags=re.IGNORECASE)
        if name not in known:
            raise ValueError(f"{where}: there is no frame '{name}'")
        if name in rows:
            raise ValueError(f"{where}: frame '{name}' is listed twice")
        if not row["site"]:
            raise ValueError(f"{where}: no site; any word will do")
        one_of(row.get("part", "train"), Part.__members__, f"{where}: part")
        rows[name] = row
    missing = [name for name in names if name not in rows]
    if missing:
        raise ValueError(f"{path}: {len(missing)} frames are not listed, the first is '{missing[0]}'")
    sites = tuple(rows[name]["site"] for name in names)
    if "part" not in rows[names[0]]:
        return sites, None
    parts = np.array([Part[rows[name]["part"]] for name in names], np.uint8)
    empty = [part.name for part in Part if part not in parts]
    if empty:
        raise ValueError(f"{path}: no frame is in part {empty[0]}; each of {', '.join(Part.__members__)} needs one")
    return sites, parts


def tissues_of_labels(path: Path) -> tuple[Tissue, ...] | None:
    """The tissue of the built-in table behind each label."""
    if not path.exists():
        return None
    known = load_tissues()
    tissues: dict[int, Tissue] = {}
    for where, row in csv_rows(path, ("label", "tissue")):
        if not row["label"].isdecimal() or not 1 <= int(row["label"]) <= MOST_LABELS:
            raise ValueError(f"{where}: label '{row['label']}'; allowed are 1 to {MOST_LABELS}")
        label = int(row["label"])
        one_of(row["tissue"], known, f"{where}: tissue")
        if label in tissues:
            raise ValueError(f"{where}: label {row['label']} is listed twice")
        tissues[label] = known[row["tissue"]]
    if sorted(tissues) != list(range(1, len(tissues) + 1)) or not tissues:
        raise ValueError(f"{path}: the labels must be 1, 2, ... without a gap, not {sorted(tissues)}")
    return tuple(tissues[label] for label in sorted(tissues))


def probe_of_fan(path: Path) -> Probe | None:
    """The probe whose fan the images are of: its kind and every length and angle, whatever its frequency."""
    if not path.exists():
        return None
    given = mapping(read_yaml(path), f"{path}", ("kind", *PROBE_KEYS))
    with naming(f"{path}: ", (ValueError, TypeError)):
        probe = probe_from(given)
    missing = [name for name in fan_values(probe) if given.get(name) is None]  # a default would be a guess
    if missing:
        raise ValueError(f"{path}: no {missing[0]}; a {probe.kind} fan has {', '.join(fan_values(probe))}")
    return probe


def odd_lengths(probe: Probe) -> str:
    """Lengths and angles that no probe has, as they stand in `fan.yaml`; empty where all are usual."""
    odd = []
    for key, (least, most) in USUAL.items():
        length = getattr(probe, key, least)
        if not least <= length <= most:
            odd.append(f"{key}: {length:g} (usual are {least:g} to {most:g})")
    return " and ".join(odd)


def fan_values(probe: Probe) -> dict[str, str | float]:
    """What `fan.yaml` holds of a probe."""
    return {name: value for name, value in plain(probe).items() if name != "frequency_mhz"}
