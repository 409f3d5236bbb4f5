"""The table of all keys of the command line, as their fields declare them: docs/settings.md.

python scripts/settings_page.py > docs/settings.md
"""

from enum import Enum

from ablate.setting import Setting, settings_of
from ablate.settings.conf import keys
from ablate.ultrasound.settings import PROBES

HEAD = """\
# All settings

`python scripts/settings_page.py > docs/settings.md` writes this page from the fields that declare the settings.
Write a setting on the command line as `key=value`. A key of a group has a dot: `training.steps=3000`.

- **Default** is the value of the code, which is the paper's where the paper gives one. The files of `conf/` set other
  values: `preset=quick`, which is used where you name no preset, sets many. `python -m ablate --cfg job` prints the
  values that a command line has in the end.
- **Decides**: "yes" means that the setting decides the result of a run and is a part of its identity. "no" means that
  it does not: a device, a path, how often something is reported, or a name that chooses other settings, such as
  `preset`. Of files, the contents decide and not the path."""
COLUMNS = ("key", "values", "default", "unit", "decides", "about")


def page() -> str:
    """The text of docs/settings.md: a table for the keys without a group, then one for each group."""
    groups: dict[str, list[tuple[str, Setting]]] = {}
    for key, setting in keys().items():
        group = key.rpartition(".")[0]
        if group != "probe":
            groups.setdefault(f"`{group}`" if group else "Without a group", []).append((key, setting))
        for kind, probe in PROBES.items() if group == "probe" else ():
            groups[f"`probe` with `probe.kind={kind}`"] = [(f"probe.{one.name}", one) for one in settings_of(probe)]
    lines = [HEAD, ""]
    for title, of_group in groups.items():
        lines.append(f"## {title}\n\n| {' | '.join(COLUMNS)} |\n| {' | '.join(['---'] * len(COLUMNS))} |")
        lines += [f"| {' | '.join(cells(name, one))} |" for name, one in of_group] + [""]
    return "\n".join(lines).rstrip().replace("<", "&lt;") + "\n"


def cells(name: str, one: Setting) -> tuple[str, ...]:
    """The cells of one key, in the order of `COLUMNS`."""
    decides = "no" if one.declared.incidental else "yes"
    return f"`{name}`", one.allowed, f"`{written(one.default)}`", one.declared.unit, decides, one.declared.about


def written(value: object) -> str:
    """A value as the command line takes it."""
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    if isinstance(value, tuple):
        return f"[{','.join(written(part) for part in value)}]"
    return f"{value:.15g}" if isinstance(value, float) else str(value.value if isinstance(value, Enum) else value)


if __name__ == "__main__":
    print(page(), end="")
