"""The components that a study switches, as conf/component declares them: a file each."""

from functools import cache
from typing import Any

import yaml

from ablate.analysis.components import Component
from ablate.settings.conf_folder import conf_folder
from ablate.settings.values import keys

# The order of tables and figures; components that are not listed follow by name.
_FIRST = ("att", "concat", "conv", "noise", "depth", "encoding")


@cache
def components() -> tuple[Component, ...]:
    """Read conf/component; a file that declares no usable component is a ValueError that names it.

    Examples
    --------
    >>> [component.name for component in components()][:3]
    ['att', 'concat', 'conv']
    """
    files = {path.stem: path for path in (conf_folder() / "component").glob("*.yaml")}
    names = [*(name for name in _FIRST if name in files), *sorted(files.keys() - set(_FIRST))]
    known = {key.name for key in keys()}
    declared = []
    for name in names:
        where = f"conf/component/{name}.yaml"
        values = yaml.safe_load(files[name].read_text("utf-8"))
        if not isinstance(values, dict):
            raise ValueError(f"{where}: holds no keys; needed are key, on and off")
        values = {_of_yaml(key): value for key, value in values.items()}
        try:
            component = Component(name, **values)
        except TypeError as error:
            raise ValueError(f"{where}: {error}") from error
        if component.key not in known:
            raise ValueError(f"{where}: key={component.key} is no key of the configuration, such as model.noise")
        declared.append(component)
    return tuple(declared)


def _of_yaml(key: Any) -> str:
    """YAML reads the keys `on` and `off` as true and false."""
    return {True: "on", False: "off"}.get(key, str(key))
