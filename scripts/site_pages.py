"""Pages of the documentation site that do not lie in docs/; mkdocs.yml names this file as a hook.

The front page is README.md. The command line is described by the comments of conf/, the API by the docstrings of what
the rooms of `ablate` offer, and each notebook by its last run.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter

ROOT = Path(__file__).parents[1]
ROOMS = ("anatomy", "ultrasound", "networks", "metrics", "dataset", "training", "pretrained", "evaluation", "analysis")
GROUPS = {"preset": "preset=", "scene": "scene=", "probe": "probe=", "variant": "variant=", "study": "+study="}
BESIDE_README = ("CONTRIBUTING.md", "CHANGELOG.md", "LICENSE", "CITATION.cff")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages; MkDocs calls this once it knows the files of docs/."""
    pages = {
        "index.md": read("README.md"),
        "pretrained/README.md": read("src/ablate/pretrained/README.md"),
        "command_line.md": command_line(),
        **{f"api/{room}.md": "\n".join(api(room)) for room in ROOMS},
    }
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    for name in BESIDE_README:
        files.append(File.generated(config, name, content=read(name)))
    for notebook in sorted((ROOT / "notebooks").glob("*.ipynb")):
        for path, content in rendered(notebook).items():
            files.append(File.generated(config, path, content=content))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Turn links of the repository into links of the site; MkDocs calls this for each page."""
    markdown = re.sub(r"\]\((notebooks/\w+)\.ipynb", r"](\1.md", markdown.replace("](../README.md", "](index.md"))
    return re.sub(r"\]\((docs|src/ablate)/", "](", markdown)


def rendered(notebook: Path) -> dict[str, str | bytes]:
    """A notebook as a page with the outputs of its last run, and its pictures."""
    kept = nbformat.read(notebook, as_version=4)
    text, resources = MarkdownExporter().from_notebook_node(kept)
    study, version = kept.metadata["ablate"]["study"], kept.metadata["ablate"]["simulator_version"]
    text += f"\n*Last run on the study `{study}`, made with version {version} of the simulator.*\n"
    pictures = {f"{notebook.stem}_{name}": content for name, content in resources["outputs"].items()}
    for name in resources["outputs"]:
        text = text.replace(f"]({name})", f"]({notebook.stem}_{name})")
    return {f"notebooks/{name}": content for name, content in {f"{notebook.stem}.md": text, **pictures}.items()}


def read(path: str) -> str:
    """The text of a file of the repository."""
    return (ROOT / path).read_text(encoding="utf-8")


def api(room: str) -> Iterator[str]:
    """The lines of the page of a room: what its `__init__.pyi` names, where it is defined."""
    package = f"ablate.{room}"
    about = ast.get_docstring(ast.parse(read(f"src/ablate/{room}/__init__.py")))
    yield f"# {package}\n\n{about}\n"
    for line in read(f"src/ablate/{room}/__init__.pyi").splitlines():
        if found := re.fullmatch(r"from (\.[\w.]+) import (\w+) as \2", line):
            yield f"::: {package}{found[1]}.{found[2]}"


def command_line() -> str:
    """All keys with their comments, and the files of each group with the first line of each."""
    lines = [
        "# Command line\n",
        "    python -m ablate key=value key=value ...         # one job",
        "    python -m ablate -m key=value,value ...          # a job for each combination of values\n",
        "[Hydra](https://hydra.cc/docs/advanced/override_grammar/basic/) has the grammar. "
        "`python -m ablate --cfg job` shows what a command line composes to; `task=plan` shows what it would run.\n",
        "[All settings](settings.md) has every key with its range and what it decides.\n",
        f"## conf/config.yaml\n\n```yaml\n{read('conf/config.yaml')}```\n",
    ]
    for group, how in GROUPS.items():
        lines.append(f"## {group.capitalize()}\n\n| key | what it is |\n| --- | --- |")
        for file in sorted((ROOT / "conf" / group).glob("*.yaml")):
            comments = [line for line in file.read_text().splitlines() if line.startswith("#")]
            said = next((c.lstrip("# ") for c in comments if "@package" not in c), "")
            lines.append(f"| `{how}{file.stem}` | {said.replace('|', ', ')} |")
        lines.append("")
    return "\n".join(lines)
