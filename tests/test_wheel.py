"""What a stranger installs: the wheel alone, in an environment of its own, used from another directory."""

import os
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def run(*command: str | Path, cwd: Path) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_an_installed_wheel_describes_the_variants_from_anywhere(tmp_path: Path) -> None:
    run(
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "-q",
        "--no-deps",
        "--no-build-isolation",
        "-w",
        tmp_path,
        ROOT,
        cwd=tmp_path,
    )
    (wheel,) = tmp_path.glob("ablate_ultrasound-*.whl")
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
        table = run(*command, "task=describe", cwd=elsewhere)
        assert "14,450,964" in table
        assert "57,171,266" in table
    assert list(elsewhere.iterdir()) == []
