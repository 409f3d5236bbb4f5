"""The table in LaTeX: every row as wide as its head, booktabs, and compiled where there is a LaTeX."""

import re
import shutil
import subprocess

import pandas as pd
import pytest

from ablate.analysis import RESIMULATION, comparison_table, to_latex
from ablate.analysis.tables import latex_text

LABELS = [f"sa2h{part}{more}" for part in ("", "-att", "-conv", "-noise") for more in ("", ".encoding-arbitrary")]


@pytest.fixture(scope="module")
def large(study_of):
    """Eight labels, a metric with a name of the user's, and metrics of a whole run."""
    study = study_of(variants=(RESIMULATION, "sa2h", "nsa2h"))
    base = study[study["variant"] == "sa2h"]
    study = pd.concat([study, *(base.assign(variant=name) for name in LABELS[1:])])
    study = pd.concat([study, base[base["metric"] == "psnr"].assign(metric="my_metric_%")])
    names = ["sa2h", "nsa2h", *LABELS[1:]]
    rows = [(v, s, m, 1.0 + k) for k, v in enumerate(names) for s in (0, 1, 2) for m in ("fd_speckle", "parameters")]
    rows += [(RESIMULATION, 0, "fd_speckle", 0.1)]
    return comparison_table(study, pd.DataFrame(rows, columns=["variant", "seed", "metric", "value"]))


def width(line):
    """Columns that a row of a tabular takes."""
    spans = [re.search(r"\\multicolumn\{(\d+)\}", cell) for cell in re.split(r"(?<!\\)&", line)]
    return sum(int(span[1]) if span else 1 for span in spans)


def test_every_row_is_as_wide_as_the_tabular(large):
    latex = to_latex(large)
    columns = len(re.search(r"\\begin\{tabular\}\{(l[r]+)\}", latex)[1])
    rows = [line for line in latex.splitlines() if line.endswith(r"\\")]
    assert {width(line) for line in rows} == {columns}
    assert len(rows) == 2 + 1 + 9, "two heads, the re-simulation, nine networks"
    for a, b in re.findall(r"\\cmidrule\(lr\)\{(\d+)-(\d+)\}", latex):
        assert 2 <= int(a) < int(b) <= columns
    for rule, count in ((r"\toprule", 1), (r"\bottomrule", 1), (r"\midrule", 4)):
        assert latex.count(rule) == count
    assert re.findall(r"\\begin\{(.+?)\}", latex) == re.findall(r"\\end\{(.+?)\}", latex)[::-1]
    assert latex.count("{") == latex.count("}")
    assert not re.search(r"(?<!\\)[_#%](?! needs)", latex), "a bare special sign"


def test_bold_is_the_best_network_and_never_the_resimulation(large):
    lines = {line.split(" & ")[0]: line for line in to_latex(large).splitlines() if line.endswith(r"\\")}
    assert r"\textbf" not in lines[RESIMULATION]
    best = large[large["best"]]
    for row in best.to_dict("records"):
        assert r"\textbf" in lines[row["variant"]]
    assert sum(line.count(r"\textbf") for line in lines.values()) == len(best)


def test_the_caption_tells_a_floor_from_a_level(large):
    caption = re.search(r"\\caption\{(.*)\}\n", to_latex(large))[1]
    assert "floor for p$\\chi^2$, FD speckle" in caption
    assert "level of a perfect stochastic renderer for PSNR" in caption
    assert "24 test frames" in caption
    assert "3 seeds" in caption
    alone = to_latex(large[large["variant"] != RESIMULATION])
    assert "floor" not in alone


def test_special_signs_are_escaped():
    assert latex_text(r"a_b%c&d#$e\f~^{}") == (
        r"a\_b\%c\&d\#\$e\textbackslash{}f\textasciitilde{}\textasciicircum{}\{\}"
    )


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="there is no LaTeX here")
def test_it_compiles(large, tmp_path):
    head = [r"\documentclass[twocolumn]{article}", r"\usepackage{booktabs}", r"\begin{document}"]
    (tmp_path / "table.tex").write_text("\n".join([*head, to_latex(large), r"\end{document}"]))
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "table.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert (tmp_path / "table.pdf").exists()
