"""What the folder conf/ declares: the components that a study switches and the variants, a file each."""

from functools import cache
from pathlib import Path

import yaml

import ablate
from ablate.analysis.components import Component
from ablate.settings.values import keys

# The order of tables and figures; components that are not listed follow by name.
_COMPONENTS = ("att", "concat", "conv", "noise", "depth", "encoding")


CUSTOM = "custom"  # the variant that a user's network takes the place of
_TABLE_II = ("lsa2h", "nsa2h", "sa2h-att", "sa2h-concat", "sa2h-conv", "sa2h-noise", "sa2h", "sa2h-depth")


def conf_folder() -> Path:
    """The folder conf/: inside the installed package, or beside src/ in a checkout."""
    package = Path(ablate.__file__).parent
    inside = package / "conf"
    return inside if inside.is_dir() else package.parents[1] / "conf"


@cache
def components() -> tuple[Component, ...]:
    """Read conf/component; a file that declares no usable component is a ValueError that names it.

    Examples
    --------
    >>> [component.name for component in components()][:3]
    ['att', 'concat', 'conv']
    """
    files = {path.stem: path for path in (conf_folder() / "component").glob("*.yaml")}
    names = [*(name for name in _COMPONENTS if name in files), *sorted(files.keys() - set(_COMPONENTS))]
    known = keys()
    declared = []
    for name in names:
        where = f"conf/component/{name}.yaml"
        values = yaml.safe_load(files[name].read_text("utf-8"))
        if not isinstance(values, dict):
            raise ValueError(f"{where}: holds no keys; needed are key, on and off")
        values = {
            {True: "on", False: "off"}.get(key, str(key)): value for key, value in values.items()
        }  # as YAML reads them
        try:
            component = Component(name, **values)
        except TypeError as error:
            raise ValueError(f"{where}: {error}") from error
        if component.key not in known:
            raise ValueError(f"{where}: key={component.key} is no key of the configuration, such as model.noise")
        declared.append(component)
    return tuple(declared)


def components_of_networks() -> dict[str, Component]:
    """The components that a generator is made of, by the field's name; others are options of data or training."""
    return {c.key.removeprefix("model."): c for c in components() if c.key.startswith("model.")}


def variant_names() -> tuple[str, ...]:
    """Every network of conf/variant, in the order of the paper's Table II, others after; `custom` names none."""
    names = {path.stem for path in (conf_folder() / "variant").glob("*.yaml")} - {CUSTOM}
    return (*[n for n in _TABLE_II if n in names], *sorted(names - set(_TABLE_II)))
