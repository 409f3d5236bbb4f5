"""What a user installs for an optional part of the program, where it is missing."""

from importlib import metadata
from pathlib import Path

_NAME = "ablate-ultrasound"


def installing(extra: str) -> str:
    """The command that installs an extra: in a checkout by its name, elsewhere the packages that it stands for.

    An installed wheel knows no address that it came from, so its own name is nothing that an installer finds.
    """
    if (Path(__file__).parents[2] / "pyproject.toml").exists():
        return f"pip install -e '.[{extra}]'"
    packages = []
    for line in metadata.requires(_NAME) or ():
        package, _, condition = line.partition(";")
        if f"'{extra}'" in condition:
            packages.append(f"'{package.strip()}'")
    return " ".join(["pip install", *packages])
