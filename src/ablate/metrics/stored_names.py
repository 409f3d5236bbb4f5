"""Names in stored scores, once for all rooms that write or read them, and the metrics that no pair of images gives."""

from ablate.metrics.metric import Direction, Group, Metric, Resimulation, Shown

SCORE_COLUMNS = ("frame", "site", "metric", "value")  # of an evaluation, one row a metric of a frame
SOURCES = MODEL, RESIMULATED = ("model", "resimulation")  # of images: the trained generator, or simulated again
STORED_COLUMNS = (*SCORE_COLUMNS, "source", "split", "variant", "seed")  # `per_image.parquet` of a run
PER_IMAGE_COLUMNS = ("variant", "seed", *SCORE_COLUMNS)  # of compared runs; the re-simulation is one of the variants
SCALAR_COLUMNS = ("variant", "seed", "metric", "value")  # one row a metric of a run; `BOUNDS` may follow
BOUNDS = ("lower", "upper")  # ends of an interval: columns of tables, and suffixes as in `test/fd_speckle_lower`
FRAME_TIME = "ms_per_frame"  # of a network, timed beside the others of its study; its bounds are quartiles
FLOOR_PREFIX = "floor_"  # of a scalar of the re-simulation, as `test/floor_psnr`


def is_bound(name: str) -> bool:
    """Whether a scalar is an end of the interval of another."""
    return name.endswith(tuple(f"_{side}" for side in BOUNDS))


_COST = (Resimulation.none, Group.cost)
ENVELOPE_RMS = Metric(
    *("envelope_rms", "Envelope error", "relative RMS", Direction.lower, Resimulation.level, Group.simulation, 4),
    place=120,
)
TIME = Metric(FRAME_TIME, "Time", "ms/frame", Direction.lower, *_COST, 1, Shown.screen | Shown.report, place=130)
PARAMETERS = Metric("parameters", "Parameters", "", Direction.none, *_COST, 0, Shown.table | Shown.report, place=140)
