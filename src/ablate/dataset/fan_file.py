"""The geometry of the fan of images made elsewhere, as `fan.yaml` holds it: a probe without its frequency."""

from pathlib import Path

from ablate.anatomy.scene_values import mapping, read_yaml
from ablate.setting import plain
from ablate.ultrasound.settings import PROBE_KEYS, Probe, probe_from


def read_fan_file(path: Path) -> Probe | None:
    """The probe whose fan the images are of: its kind and every length and angle, whatever its frequency."""
    if not path.exists():
        return None
    if not path.is_file():
        raise ValueError(f"{path}: is no file")
    given = mapping(read_yaml(path), f"{path}", ("kind", *PROBE_KEYS))
    try:
        probe = probe_from(given)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: {error}") from error
    if missing := [name for name in fan_values(probe) if given.get(name) is None]:  # a default would be a guess
        raise ValueError(f"{path}: no {missing[0]}; a {probe.kind} fan has {', '.join(fan_values(probe))}")
    return probe


def fan_values(probe: Probe) -> dict[str, str | float]:
    """What `fan.yaml` holds of a probe."""
    return {name: value for name, value in plain(probe).items() if name != "frequency_mhz"}
