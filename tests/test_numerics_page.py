"""docs/numerics.md takes what scripts/numerics.py measures, and shows only what is there."""

import re

import pandas as pd

from support.scripts import ROOT, script

page = script("scripts/numerics.py")


def test_every_mark_of_the_page_is_filled() -> None:
    text = (ROOT / "docs" / "numerics.md").read_text()
    marks = re.findall(r"<!-- table: (.+?) -->", text)
    assert len(marks) == text.count("<!-- end -->") == len(set(marks))
    known = {f"{part} {name}" for part in ("fetal", "paper", "patient") for name in (*page.TABLES, "about", "verdict")}
    assert set(marks) <= known | {"scaling"}
    filled = page.fill(text, {name: f"| {name} |" for name in marks})
    assert all(f"<!-- table: {name} -->\n| {name} |\n<!-- end -->" in filled for name in marks)
    outside = re.compile(r"(<!-- table: .+? -->\n).*?(<!-- end -->)", re.S)
    assert outside.sub(r"\1\2", filled) == outside.sub(r"\1\2", text), "all other text is left as it is"


def test_a_table_keeps_its_index() -> None:
    table = pd.DataFrame({"p": ["0.5"]}, index=pd.Index(["MAE"], name="error"))
    assert page.markdown(table) == "| error | p |\n| --- | --- |\n| MAE | 0.5 |"
    assert page.markdown(pd.DataFrame()) == "(nothing of this kind was measured)"
