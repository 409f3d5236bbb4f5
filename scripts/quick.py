"""The tests of what changed since the last commit, or of one sub-package, for as long as fits into a minute.

python scripts/quick.py           # what differs from the last commit; where nothing does, what that commit changed
python scripts/quick.py metrics   # the tests of one sub-package

Tests of changed modules come first. Tests that would start after 28 seconds are skipped and counted; `make test` runs
them.
"""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SECONDS = 28


def changed_files() -> list[Path]:
    """Files that differ from the last commit, or the files of that commit where none does."""

    def git(*arguments: str) -> list[Path]:
        answer = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=True)
        return [Path(line) for line in answer.stdout.splitlines()]

    status = git("diff", "--name-only", "HEAD") + git("ls-files", "--others", "--exclude-standard")
    return status or git("diff", "--name-only", "HEAD~1", "HEAD")


def tests_of(files: list[Path]) -> list[str]:
    """Test files that changed, or are named as a changed module; then the folders of the sub-packages."""
    named, folders = [], []
    for file in files:
        if file.match("tests/**/test_*.py") and (ROOT / file).exists():
            named.append(str(file))
        elif file.suffix == ".py" and file.parts[:2] == ("src", "ablate"):
            room = file.parts[2].removesuffix(".py")
            named += [str(path.relative_to(ROOT)) for path in (ROOT / "tests").rglob(f"test_{file.stem}.py")]
            folders += [f"tests/{room}"] if (ROOT / "tests" / room).is_dir() else []
    return list(dict.fromkeys([*named, *folders]))


def main() -> int:
    """Run the tests; returns the exit code of pytest, or 0 where nothing is to be tested."""
    chosen = [f"tests/{room}" for room in sys.argv[1:]] or tests_of(changed_files())
    if not chosen:
        print("no module changed: no test")
        return 0
    command = ["pytest", "-n", "2", "--dist", "worksteal", "-m", "not slow", f"--seconds={SECONDS}", *chosen]
    return subprocess.run([sys.executable, "-m", *command], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
