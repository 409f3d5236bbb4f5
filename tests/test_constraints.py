"""The pinned set of packages can be installed where the project says that it runs."""

import subprocess
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

CONSTRAINTS = Path(__file__).parents[1] / "constraints.txt"
OF_A_GPU = ("cuda-", "nvidia-", "triton")  # what torch's build for one asks for; it names the releases itself


def pins() -> dict[str, str]:
    lines = [line for line in CONSTRAINTS.read_text().splitlines() if line and not line.startswith("#")]
    return {name.lower().replace("_", "-"): version for name, version in (line.split("==") for line in lines)}


def is_installed(name: str) -> bool:
    """Whether a package is installed here; some are for other systems."""
    try:
        return bool(distribution(name))
    except PackageNotFoundError:
        return False


@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13"])
def test_the_pins_hold_all_that_is_required_and_agree_with_each_other(python: str) -> None:
    """From the project with its extra `dev` along the metadata of each package, as another Python would read it."""
    pinned = {canonicalize_name(name): version for name, version in pins().items()}
    waiting, seen, wrong = [("ablate-ultrasound", "dev")], set(), []
    while waiting:
        package, extra = waiting.pop()
        if (package, extra) in seen:
            continue
        seen.add((package, extra))
        surroundings = {"python_version": python, "python_full_version": f"{python}.9", "extra": extra}
        if not is_installed(package):  # only another Python needs it; that it is pinned has been seen
            continue
        for line in distribution(package).requires or []:
            asked = Requirement(line)
            if package == "torch" and asked.name.startswith(OF_A_GPU):
                continue
            if asked.marker and not asked.marker.evaluate(surroundings):
                continue
            name = canonicalize_name(asked.name)
            if name != "ablate-ultrasound" and not asked.specifier.contains(pinned.get(name, ""), prereleases=True):
                wrong.append(f"{package} requires {asked}, pinned is {pinned.get(name, 'nothing')}")
            else:
                waiting += [(name, extra) for extra in ("", *asked.extras)]
    assert not wrong


@pytest.mark.parametrize("python", ["3.11.2", "3.12.0", "3.13.0"])
def test_every_pin_takes_the_first_releases_of_a_supported_python(python: str) -> None:
    """Debian 12 has 3.11.2: a pin that asks for a later one breaks `make test` there."""
    asks = {name: distribution(name).metadata.get("Requires-Python") for name in pins() if is_installed(name)}
    assert len(asks) > 0.9 * len(pins())
    assert {name: asked for name, asked in asks.items() if asked and python not in SpecifierSet(asked)} == {}


@pytest.mark.slow
@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13"])
def test_every_pin_is_there_for_a_supported_python(tmp_path: Path, python: str) -> None:
    """Each release takes this Python, and has a wheel for it or its source."""
    asked = ["--dry-run", "--ignore-installed", "--no-deps", "--python-version", python, "--target", str(tmp_path)]
    command = [sys.executable, "-m", "pip", "install", *asked, "-r", str(CONSTRAINTS)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=1200)
    if done.returncode and not index_is_there(tmp_path):
        pytest.skip("no package index can be reached")
    assert done.returncode == 0, done.stderr[-2000:]
    (would,) = [line for line in done.stdout.splitlines() if line.startswith("Would install ")]
    installed = dict(name.rsplit("-", 1) for name in would.removeprefix("Would install ").split())
    public = {name.lower().replace("_", "-"): version.partition("+")[0] for name, version in installed.items()}
    assert public == pins()  # an index may have torch 2.13.0 as 2.13.0+cpu, which == takes


def index_is_there(folder: Path) -> bool:
    command = [sys.executable, "-m", "pip", "download", "--no-deps", "--dest", str(folder), f"zipp=={pins()['zipp']}"]
    return subprocess.run(command, capture_output=True, check=False, timeout=600).returncode == 0
