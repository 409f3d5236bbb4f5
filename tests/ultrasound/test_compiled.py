"""What is kept of compiled functions follows the sources."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import ablate

SCRIPT = """
import numpy as np, trimesh
from ablate.anatomy import Structure, Tissue
from ablate.ultrasound.embree import Geometry
from ablate.ultrasound.slices import sample_lines
from ablate.ultrasound.walk import Samples
box = Structure(trimesh.creation.box((10, 10, 10)), Tissue("t"))
geometry = Geometry([box], np.array([[-5.0] * 3, [5.0] * 3]), np.zeros(3), 50.0)
samples = Samples(0.0, 1.0, 40, np.arange(2, dtype=np.uint8))
print(sample_lines(geometry, np.array([[0.0, 0, -20]]), np.array([[0.0, 0, 1]]), samples)[0].sum())
"""


def test_a_change_in_another_file_is_compiled_in(tmp_path) -> None:
    """`walk` calls `ownership`: of a change there alone Numba itself would not know."""
    copy = tmp_path / "ablate"
    shutil.copytree(Path(ablate.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | {"PYTHONPATH": str(tmp_path)}

    def samples_inside() -> int:
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT], env=environment, cwd=tmp_path, check=True, capture_output=True, text=True
        )
        return int(done.stdout)

    assert samples_inside() == 11
    file = copy / "ultrasound" / "ownership.py"
    before = file.read_text()
    after = before.replace("return 32 * word +", "return 0 *")
    assert after != before
    file.write_text(after)
    assert samples_inside() == 0
