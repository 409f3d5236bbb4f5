"""The report stands alone and says what may not be concluded."""

import re
from html.parser import HTMLParser

import pandas as pd

from ablate.analysis import DrawnFigure, Section, StudyResults, best_in_words, write_report


class Resources(HTMLParser):
    """Collects what a page would load, and checks that tags are closed in order."""

    def __init__(self):
        super().__init__()
        self.sources, self.open = [], []

    def handle_starttag(self, tag, attrs):
        self.sources += [value for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def picture(folder, name):
    """A file in place of a figure: the report takes its bytes as they are."""
    path = folder / f"{name}.png"
    path.write_bytes(b"a picture")
    return path


def test_report_is_self_contained(study, tmp_path):
    path = write_report(
        tmp_path / "report.html",
        StudyResults(per_image=study),
        "quick <study>",
        figures=[DrawnFigure(picture(tmp_path, "boxplot_psnr"), "Paired differences in PSNR")],
        left_out=["refraction: speeds agree"],
        provenance={"commit": "abc123"},
    )
    page = path.read_text("utf-8")
    parser = Resources()
    parser.feed(page)
    assert not parser.open
    assert len(parser.sources) == 1
    assert parser.sources[0].startswith("data:image/png;base64,")
    assert not re.search(r"https?://", page)
    results = StudyResults(per_image=study)
    best = best_in_words(results.table, results.claims, results.reference)
    assert page.index(f"<strong>Best</strong>: {best}.") < page.index("<h2>"), "it is what a reader asks first"
    for text in ("quick &lt;study&gt;", "refraction: speeds agree", "abc123", "floor for", "level of", "differs"):
        assert text in page
    assert not re.search(r"\bnan\b", re.sub(r"base64,[^\"]*", "", page).lower())


def test_a_network_without_a_value_has_a_dash_on_the_scale(study, tmp_path):
    formula = study[study["variant"] == "sa2h"].assign(variant="formula", value=lambda t: t["value"] + 5)
    whole = pd.concat([study, formula])
    lacks = whole[(whole["variant"] != "nsa2h") | (whole["metric"] != "pchi2")]
    page = write_report(tmp_path / "report.html", StudyResults(per_image=lacks), "partly scored").read_text("utf-8")
    assert re.search(r"<tr><td>pχ²</td>.*<td>–</td>", page)
    assert "nan" not in page


def test_report_folds_what_is_secondary(study, tmp_path):
    lesser = study.assign(metric=study["metric"].replace("psnr", "pchi2_fan"))
    both = pd.concat([study, lesser[lesser["metric"] == "pchi2_fan"]])
    figures = [
        DrawnFigure(picture(tmp_path, "boxplots"), "Box plots"),
        DrawnFigure(picture(tmp_path, "boxplot_psnr"), "One box plot", Section.folded),
    ]
    path = write_report(tmp_path / "report.html", StudyResults(per_image=both), "folded", figures=figures)
    page = re.sub(r"base64,[^\"]*", "", path.read_text("utf-8"))
    folded = re.findall(r"<details><summary>(.*?)</summary>(.*?)</details>", page, re.S)
    titles = [title for title, _ in folded]
    assert titles == ["All other metrics", "All other metrics", "More figures"]
    shown = re.sub(r"<details>.*?</details>", "", page, flags=re.S)
    shown = re.sub(r"<h2>Does a variant differ.*?(?=<h2>)", "", shown, flags=re.S)  # it has all metrics
    for text in ("PSNR (dB)", "Box plots", "3 variants, 3 trained of each, 24 test frames of 8 probe sites."):
        assert text in shown
    for text in ("pχ² in fan", "One box plot"):
        assert text not in shown
        assert any(text in content for _, content in folded)
