"""The documentation builds as a site without a broken link, and its reference has what the rooms offer."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_the_site_has_every_page_and_every_name_that_a_room_offers(tmp_path: Path) -> None:
    pytest.importorskip("mkdocstrings", reason="mkdocstrings is not installed: pip install with the extra [docs]")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(tmp_path)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    for page in (ROOT / "docs").glob("*.md"):
        assert (tmp_path / f"{page.stem}.html").exists()
    for stub in (ROOT / "src/ablate").glob("*/__init__.pyi"):
        page = tmp_path / "api" / f"{stub.parent.name}.html"
        if page.exists():
            offered = re.findall(r"import \w+ as (\w+)", stub.read_text())
            ids = set(re.findall(r'id="ablate\.[\w.]+\.(\w+)"', page.read_text()))
            assert not set(offered) - ids
    assert len(list((tmp_path / "api").glob("*.html"))) == 9
    assert "ablate runs ablation studies" in re.sub(r"<[^>]+>", "", (tmp_path / "index.html").read_text())
