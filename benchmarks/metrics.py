"""What scoring costs: each metric, of one frame of the paper's size.

make bench-metrics

Some such frames are simulated, with a coarser anatomy. Give it the machine alone.
"""

import tempfile
import time
from collections.abc import Callable
from statistics import median

import numpy as np
import torch

from ablate.anatomy import TissueKind
from ablate.command.compose import jobs_of
from ablate.dataset import Part
from ablate.evaluation import tissue_labels
from ablate.metrics import METRICS, Pair, speckle_features
from ablate.sources.data_set import DataSet as Data
from ablate.sources.data_set import maps_needed
from ablate.sources.prepare import prepare_data
from ablate.study.provenance import hardware
from ablate.ultrasound import ConvexProbe
from ablate.ultrasound.probe import pixel_polar, pixel_size_mm
from yardstick import Yardstick

SIMULATED = 16
REPEATS = 5


def simulated(folder: str) -> Data:
    """Frames of the paper's size, some of them unseen."""
    size = [f"dataset.frames={SIMULATED}", "dataset.split=frame", "dataset.validation=0.1", "dataset.test=0.4"]
    (job,) = jobs_of(["preset=paper", f"runs_dir={folder}", *size, "scene.triangles=60000"])
    return prepare_data(job.settings, job.data, job.identity["data"], maps_needed([job.settings.model]))


def milliseconds(call: Callable[[], object]) -> float:
    """Of one thread's processor time, after a first call that does not count."""
    call()
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        call()
        times.append(1e3 * (time.process_time() - start))
    return median(times)


def one_frame(data: Data) -> list[tuple[str, float]]:
    """What each metric costs of one frame, and what an evaluation does beside them."""
    pairs = data.pairs
    frame = int(np.flatnonzero(pairs.split != Part.train)[0])
    solid, bone, mask = tissue_labels(data.tissues), tissue_labels(data.tissues, [TissueKind.bone]), pairs.mask()
    depth, pixel_mm = pixel_polar(ConvexProbe(), pairs.shape)[0], pixel_size_mm(ConvexProbe(), pairs.shape)
    maps = {name: pairs.read(name, [frame])[0] for name in pairs.maps}

    def pair() -> Pair:
        labels, image, target = (maps[name] for name in ("segmentation", "resimulation", "target"))
        tissue, of_bone = np.isin(labels, solid), np.isin(labels, bone)
        draws = np.stack([image, target, image])
        return Pair(image, target, mask, tissue, maps["attenuation"], depth, labels, of_bone, pixel_mm, draws)

    beside = milliseconds(pair)
    measures = {name: metric.of_image or metric.of_draws for name, metric in METRICS.items()}
    of_image = {name: measure for name, measure in measures.items() if measure}
    rows = [(name, milliseconds(lambda m=measure: m(pair())) - beside) for name, measure in of_image.items()]
    rows.append(
        ("fd_speckle: features of both", 2 * milliseconds(lambda: speckle_features(maps["target"][None], mask)))
    )
    rows.append(
        ("reading S, A and H", milliseconds(lambda: [pairs.read(n, [frame]) for n in maps if n != "resimulation"]))
    )
    rows.append(("where is tissue", beside))
    return rows


def main() -> None:
    """Simulate and print the table."""
    print(hardware())
    with tempfile.TemporaryDirectory() as folder:
        data = simulated(folder)
        torch.set_num_threads(1)
        yardstick = Yardstick()
        yardstick.tick()
        rows = one_frame(data)
        yardstick.tick()
        print(f"\nOne frame of {data.pairs.shape[0]} x {data.pairs.shape[1]}, one thread      ms")
        for name, cost in (*rows, ("together, patch maps counted once", _together(rows))):
            print(f"{name:40} {cost:8.1f}")

        print(yardstick.line())


def _together(rows: list[tuple[str, float]]) -> float:
    again = [cost for name, cost in rows if name in ("pchi2_fan", "pchi2_tissue")]
    return sum(cost for _, cost in rows) - sum(again)


if __name__ == "__main__":
    main()
