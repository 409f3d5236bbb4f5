"""Files that are written whole or not at all."""

from pathlib import Path

import pytest

from ablate.storage import remove_partial, written_whole


def test_a_file_is_replaced_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text("old")
    with written_whole(path) as partial:
        partial.write_text("new")
        assert (path.read_text(), partial.suffix) == ("old", ".json")
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]
    assert path.read_text() == "new"


def test_an_error_leaves_what_was_there_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text("old")
    with pytest.raises(UnicodeEncodeError), written_whole(path) as partial:
        partial.write_text("half\n" * 10_000 + "\ud800", encoding="utf-8")
    assert [p.read_text() for p in tmp_path.iterdir()] == ["old"]


def test_several_may_write_one_file_at_once(tmp_path: Path) -> None:
    path = tmp_path / "a"
    with written_whole(path) as one, written_whole(path) as other:
        one.write_text("outer")
        other.write_text("inner")
    assert [p.read_text() for p in tmp_path.iterdir()] == ["outer"]


def test_only_leftovers_of_the_same_file_are_removed(tmp_path: Path) -> None:
    for name in ("a[1].ckpt", "a[1].deadbeef.partial.ckpt", "b.deadbeef.partial.ckpt"):
        (tmp_path / name).touch()
    remove_partial(tmp_path / "a[1].ckpt")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a[1].ckpt", "b.deadbeef.partial.ckpt"]
