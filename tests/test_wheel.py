"""What a stranger installs: the wheel alone, in an environment of its own, used from another directory."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def run(*command: str | Path, cwd: Path) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def built(folder: Path) -> Path:
    """The wheel of this checkout."""
    words = ["wheel", "-q", "--no-deps", "--no-build-isolation", "-w", folder, ROOT]
    run(sys.executable, "-m", "pip", *words, cwd=folder)
    (wheel,) = folder.glob("ablate_ultrasound-*.whl")
    return wheel


@pytest.mark.slow
def test_an_installed_wheel_describes_the_variants_from_anywhere(tmp_path: Path) -> None:
    wheel = built(tmp_path)
    venv.create(tmp_path / "env", with_pip=False)
    python = tmp_path / "env" / "bin" / "python"
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=tmp_path).strip())
    target = ["--target", site, "--no-deps", "--no-compile", "--no-warn-script-location"]
    run(sys.executable, "-m", "pip", "install", "-q", *target, wheel, cwd=tmp_path)
    # The dependencies come from the environment of the tests; its own ablate is not reachable this way.
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    assert run(python, "-c", "import ablate; print(ablate.__file__)", cwd=elsewhere).strip().startswith(str(site))
    for command in ([python, "-m", "ablate"], [python, site / "bin" / "ablate"]):
        table = run(*command, "task=describe", "preset=paper", cwd=elsewhere)
        assert "14,450,964" in table
        assert "57,171,266" in table
    assert list(elsewhere.iterdir()) == []


def interpreter(version: str) -> str | None:
    """A Python of this version on this machine, beside the one that runs the tests."""
    known = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions").glob(f"{version}.*/bin/python")
    for candidate in (shutil.which(f"python{version}"), *sorted(map(str, known))):
        if candidate and subprocess.run([candidate, "-c", ""], capture_output=True, check=False).returncode == 0:
            return candidate
    return None


@pytest.mark.slow
@pytest.mark.parametrize("version", ["3.11", "3.12", "3.13"])
def test_the_wheel_in_an_empty_environment_runs_the_lines_of_the_readme(version: str, tmp_path: Path) -> None:
    """With the pinned dependencies and no extras: a frame, a network that reads it, and a study of one training."""
    python = interpreter(version)
    if python is None:
        pytest.skip(f"there is no Python {version} on this machine")
    run(python, "-m", "venv", tmp_path / "env", cwd=tmp_path)
    inside = tmp_path / "env" / "bin" / "python"
    run(inside, "-m", "pip", "install", "-q", "-c", ROOT / "constraints.txt", built(tmp_path), cwd=tmp_path)
    lines = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    (example,) = (block for block in lines if "Simulator(" in block)
    check = "assert image.shape == (256, 355) and abs(image[frame.mask].mean() - frame.image[frame.mask].mean()) < 10"
    run(inside, "-c", "\n".join([example, check]), cwd=tmp_path)
    study = ["preset=tiny", "training.steps=2", "training.validate_every=0", f"runs_dir={tmp_path / 'runs'}"]
    assert "sa2h" in run(inside, "-m", "ablate", *study, cwd=tmp_path)
