"""The pages of docs/ are what scripts print and measure, and the site is built without a broken link."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from support.scripts import ROOT, script

settings_page, page = script("scripts/settings_page.py"), script("scripts/numerics.py")


def test_the_page_is_what_the_script_prints() -> None:
    assert (ROOT / "docs" / "settings.md").read_text("utf-8") == settings_page.page()


@pytest.mark.parametrize("name", ["numerics.md", "teachers.md"])
def test_every_mark_of_the_pages_is_filled(name: str) -> None:
    text = (ROOT / "docs" / name).read_text()
    marks = re.findall(r"<!-- table: (.+?) -->", text)
    assert len(marks) == text.count("<!-- end -->") == len(set(marks))
    known = {f"{part} {table}" for part in page.PARTS for table in ("order", "verdict", "worth")}
    assert set(marks) <= known | {"scaling", "paper scores"}
    filled = page.fill(text, {name: f"| {name} |" for name in marks})
    assert all(f"<!-- table: {name} -->\n| {name} |\n<!-- end -->" in filled for name in marks)
    outside = re.compile(r"(<!-- table: .+? -->\n).*?(<!-- end -->)", re.S)
    assert outside.sub(r"\1\2", filled) == outside.sub(r"\1\2", text), "all other text is left as it is"


@pytest.mark.slow
def test_the_site_has_every_page_and_every_name_that_a_room_offers(tmp_path: Path) -> None:
    pytest.importorskip("mkdocstrings", reason="mkdocstrings is not installed: pip install with the extra [docs]")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(tmp_path)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    for file in (ROOT / "docs").glob("*.md"):
        assert (tmp_path / f"{file.stem}.html").exists()
    for stub in (ROOT / "src/ablate").glob("*/__init__.pyi"):
        file = tmp_path / "api" / f"{stub.parent.name}.html"
        if file.exists():
            offered = re.findall(r"import \w+ as (\w+)", stub.read_text())
            ids = set(re.findall(r'id="ablate\.[\w.]+\.(\w+)"', file.read_text()))
            assert not set(offered) - ids
    assert len(list((tmp_path / "api").glob("*.html"))) == 9
    assert "lets you extend, the ablation study" in re.sub(r"<[^>]+>", "", (tmp_path / "index.html").read_text())
