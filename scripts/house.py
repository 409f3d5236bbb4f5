"""The structure of the package as a table: rooms, files, lines, and the imports between rooms.

python scripts/house.py              # of this checkout
python scripts/house.py --src DIR    # of the folder `src` of another checkout
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

import grimp
import pandas as pd

ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    """Print one row a room: files, lines, its longest file, its fullest folder, and the rooms that it imports."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--src", type=Path, default=ROOT / "src")
    src = parser.parse_args().src.resolve()
    sys.path.insert(0, str(src))
    graph = grimp.build_graph("ablate", cache_dir=None)

    def room_of(module: str) -> str:
        return module.split(".")[1] if "." in module else module

    imports: dict[str, Counter[str]] = {}
    for module in graph.modules:
        for imported in graph.find_modules_directly_imported_by(module):
            if room_of(module) != room_of(imported):
                imports.setdefault(room_of(module), Counter())[room_of(imported)] += 1
    rows = []
    for entry in sorted((src / "ablate").iterdir()):
        files = [entry] if entry.suffix == ".py" else sorted(entry.rglob("*.py"))
        files = [path for path in files if path.name != "__init__.py"]
        if not files:
            continue
        lines = {path: len(path.read_text().splitlines()) for path in files}
        folders = Counter(path.parent for path in files)
        used = imports.get(entry.stem, Counter())
        rows.append(
            {
                "room": entry.stem,
                "files": len(files),
                "lines": sum(lines.values()),
                "longest": max(lines.values()),
                "fullest folder": max(folders.values()),
                "imports of other rooms": sum(used.values()),
                "which": ", ".join(f"{room} {count}" for room, count in used.most_common()),
            }
        )
    table = pd.DataFrame(rows).sort_values("lines", ascending=False)
    total = table[["files", "lines", "imports of other rooms"]].sum()
    print(table.to_string(index=False))
    print(f"\n{total['files']} files, {total['lines']} lines, {total['imports of other rooms']} imports between rooms")


if __name__ == "__main__":
    main()
