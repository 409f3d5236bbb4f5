"""Files that are written whole or not at all."""

import re
import threading
import time
from pathlib import Path

import pytest

import ablate
from ablate.storage import digest_of_files, held, read_json, remove_partial, written_whole

# Calls that write a file in place; what they are given must be the name that `written_whole` gives.
WRITERS = re.compile(r"\.(write_text|write_bytes|to_csv|to_parquet|savefig)\(|\.(save|savez|savez_compressed)\(")
# The module that defines `written_whole`, and functions that write to a path their caller has from it.
WRITES = {"storage.py", "scene.py", "results_view.py"}  # the last to a temporary folder


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


def test_every_file_of_the_package_is_written_whole() -> None:
    """A kill while a file is written in place leaves half of it, which later commands stumble over."""
    root = Path(ablate.__file__).parent
    lines = [
        f"{path.relative_to(root)}: {line.strip()}"
        for path in root.rglob("*.py")
        if path.name not in WRITES
        for line in path.read_text().splitlines()
        if WRITERS.search(line)
        and not re.search(r"partial|BytesIO|in_memory|(?<!\.)write_text\(", line)
        and not line.strip().startswith((">>>", "..."))
        and "sweep.save(" not in line  # that one takes a folder
    ]
    assert lines == []


@pytest.mark.parametrize("content", ["", "{", "[1]", "null", "[" * 100_000, "\ud800"])
def test_what_is_no_json_object_is_named(tmp_path: Path, content: str) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(content.encode("utf-8", "surrogatepass"))
    with pytest.raises(ValueError, match=r"a\.json cannot be read"):
        read_json(path)


def test_the_digest_of_files_tells_content_and_name_and_passes_over_what_is_missing(tmp_path: Path) -> None:
    one, other, missing = tmp_path / "one", tmp_path / "other", tmp_path / "missing"
    one.write_text("a")
    other.write_text("a")
    assert digest_of_files([one, missing]) == digest_of_files([one]) != digest_of_files([other])
    before = digest_of_files([one, other])
    other.write_text("b")
    assert digest_of_files([one, other]) != before


def test_a_lock_that_another_has_is_waited_for_and_named_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, told, done = tmp_path / ".lock", [], []

    def second() -> None:
        with held(path, "trains sa2h/seed0"):
            done.append(True)

    with held(path, "trains sa2h/seed0"):
        assert capsys.readouterr().err == ""
        waiting = threading.Thread(target=second)
        waiting.start()
        until = time.monotonic() + 10
        while not told and time.monotonic() < until:
            told += capsys.readouterr().err.splitlines()
            time.sleep(0.01)
        assert not done
    waiting.join(10)
    assert told == [f"waiting for another process, which trains sa2h/seed0 ({tmp_path})"]
    assert done
