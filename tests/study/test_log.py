"""What a training logs is on disk, each step once, however often it is stopped."""

import math
from pathlib import Path

import numpy as np
from PIL import Image

from ablate.study.log import LocalLog, Point, Status, read_log


def test_a_resumed_training_logs_each_step_once_and_a_line_cut_short_is_dropped(tmp_path: Path) -> None:
    first = LocalLog(tmp_path)
    first.status(Status.running)
    for step in (4, 8):
        first.metrics({"l1": step / 2, "undefined": math.nan, "infinite": -math.inf}, step)
    with (tmp_path / "log.jsonl").open("a") as file:
        file.write('{"time": 1, "step": 12, "metr')
    second = LocalLog(tmp_path)
    for step in (8, 12):
        second.metrics({"l1": 7.0, "l2": 1.0}, step)
    log = read_log(tmp_path)
    assert [(p.key, p.step, p.value) for p in log.points] == [
        ("l1", 4, 2.0),
        ("l1", 8, 4.0),
        ("l2", 8, 1.0),
        ("l1", 12, 7.0),
        ("l2", 12, 1.0),
    ]
    assert [status for _, status in log.states] == [Status.running]
    assert log.began_ms == log.states[0][0]


def test_images_are_kept_by_series_and_step_and_one_that_is_there_stays(tmp_path: Path) -> None:
    frames = np.random.default_rng(0).integers(0, 256, (3, 20, 30), np.uint8)
    log = LocalLog(tmp_path)
    for step in (0, 8, 16):
        log.image("frame 7 - a/b", frames[step // 8], step)
    log.image("frame 7 - a/b", frames[0], 8)  # a step that is done again
    images = read_log(tmp_path).images
    assert [(image.key, image.step) for image in images] == [("frame 7 - a/b", step) for step in (0, 8, 16)]
    for image, frame in zip(images, frames, strict=True):
        np.testing.assert_array_equal(np.asarray(Image.open(image.path)), frame)


def test_a_training_that_begins_anew_begins_a_new_log(tmp_path: Path) -> None:
    """Curves of a training that was thrown away were once shown as those of the new one."""
    log = LocalLog(tmp_path)
    log.metrics({"l1": 1.0}, 4)
    log.image("frames/1", np.zeros((2, 2), np.uint8), 4)
    log = LocalLog(tmp_path, anew=True)
    assert read_log(tmp_path).points == read_log(tmp_path).images == ()
    log.metrics({"l1": 0.5}, 4)
    (point,) = read_log(tmp_path).points
    assert point == Point("l1", 0.5, point.time_ms, 4)


def test_no_log_is_an_empty_one_and_damaged_lines_are_passed_over(tmp_path: Path) -> None:
    assert read_log(tmp_path).began_ms is None
    lines = b'\x00\x00\n[1]\n{"step": 3}\n{"time": 5, "step": 4, "metrics": {"l1": 1.0}}\n'
    (tmp_path / "log.jsonl").write_bytes(lines)
    assert read_log(tmp_path).points == (Point("l1", 1.0, 5, 4),)
