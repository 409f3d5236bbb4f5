"""Pictures of a run that cannot be unpacked."""

from pathlib import Path

import numpy as np
import pytest

from ablate.study.training import Training


def test_a_training_that_begins_again_has_no_pictures_of_other_weights(tmp_path: Path) -> None:
    run = Training(tmp_path)
    np.savez(run.pictures_file, frames=[3], images=np.zeros((1, 2, 2), np.uint8))
    assert run.pictures
    run.begin_again()
    assert run.pictures == {}


@pytest.mark.parametrize("field", [{"PK\x03\x04": 8, "PK\x01\x02": 10}, {"PK\x03\x04": 6, "PK\x01\x02": 8}])
def test_an_archive_packed_in_an_unknown_way_or_with_a_password_is_damaged(
    field: dict[str, int], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The method of each file in it becomes 99, which does not exist, or its flags say that it is encrypted."""
    run = Training(tmp_path)
    np.savez(run.pictures_file, frames=[3], images=np.full((1, 2, 2), 7, np.uint8))
    assert run.pictures[3].tolist() == [[7, 7], [7, 7]]
    content = bytearray(run.pictures_file.read_bytes())
    for mark, at in field.items():
        place = -1
        while (place := content.find(mark.encode(), place + 1)) >= 0:
            content[place + at] = 99
    run.pictures_file.write_bytes(content)
    assert run.pictures == {}
    assert "pictures.npz is damaged" in caplog.text
