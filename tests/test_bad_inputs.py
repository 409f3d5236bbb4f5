"""What cannot be run is refused in one line that says what is wrong, before anything starts; no file is left behind."""

import copy
import dataclasses
import errno
import math
import os
import re
from collections.abc import Callable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest
import trimesh
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from omegaconf import DictConfig, OmegaConf

from ablate.__main__ import main
from ablate.command.compose import composed
from ablate.command.refusals import in_one_line
from ablate.command.schema import settings as settings_of_config
from ablate.setting import plain
from ablate.settings.conf import build
from ablate.settings.study import ConfigurationError, StudySettings
from ablate.ultrasound.settings import PROBE_KEYS, Probe, ProbeKind

Refused = Callable[..., str]


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Refused:
    """Calls the program with arguments that it refuses; gives the line that it prints."""

    def files() -> set[Path]:
        kept = (path for path in tmp_path.rglob("*") if path.is_file())
        return {path for path in kept if path.suffix != ".pyc"}  # of the user's own modules

    def starts(*_: object) -> None:
        raise AssertionError("a job was started")

    def call(*arguments: str) -> str:
        before = files()
        monkeypatch.setattr("sys.argv", ["ablate", f"runs_dir={tmp_path / 'runs'}", *arguments])
        with pytest.raises(SystemExit) as end:
            main()
        assert end.value.code == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        assert files() == before
        line, newline, rest = printed.err.partition("\n")
        assert (line[:8], newline, rest) == ("ablate: ", "\n", ""), printed.err
        return line[8:]

    monkeypatch.setattr("ablate.tasks.entry.start_here", starts)
    monkeypatch.setattr("ablate.command.launch._start", starts)
    monkeypatch.chdir(tmp_path)
    return call


def scene_folder(folder: Path, **changes: object) -> None:
    """A folder with a good and a bad mesh, and a scene.yaml with some keys changed."""
    folder.mkdir()
    trimesh.creation.icosphere(3, radius=60).export(folder / "body.obj")
    (folder / "garbage.ply").write_bytes(b"not a mesh")
    sites = {"axis": [0, 0, 1], "heights": [-10, 10], "angles": [-20, 20]}
    scene = {"structures": [{"mesh": "body.obj", "tissue": "soft_tissue"}], "sites": sites}
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene | changes))


# Each with the words of the answer, as a regular expression.
COMMAND_LINES: list[tuple[list[str], str]] = [
    # What is not there.
    (["variant=sa3h"], r"variant=sa3h: allowed are custom, full, lsa2h, nsa2h, sa2h, "),
    (["gain_db=6"], r"gain_db=6: allowed with task=render or view, as it is of a picture alone"),
    (["task=render", "gain_db=200"], r"gain_db=200.*: allowed are numbers from -100 to 100"),
    (["variant=sa2hh"], r"allowed are custom, .*; did you mean sa2h\?"),
    (["task=render", "plane=femurr"], r"plane=femurr: allowed are head, .*; did you mean femur\?"),
    (["task=view", "plane=Feemur"], r"plane=Feemur: allowed are head, .*; did you mean femur\?"),
    (["reference=sa2-att"], r"reference=sa2-att: allowed are .*; did you mean sa2h-att\?"),
    (["metrics=[psnr,pchi]"], r"metrics=pchi: allowed are all, .*; did you mean pchi2\?"),
    (["objective=val/psmr"], r"objective=val/psmr: allowed are .*; did you mean val/psnr\?"),
    (["scene.kind=fetall"], r"scene\.kind='fetall'.*: allowed are .*; did you mean fetal\?"),
    (["task=comparee"], r"task=comparee: allowed are study, .*; did you mean compare\?"),
    (["model.noise=injekt"], r"model\.noise=injekt: allowed are .*; did you mean inject\?"),
    (["simulator.tgc=Patiant"], r"simulator\.tgc=Patiant: allowed are fixed, patient; did you mean patient\?"),
    (["simulator.device=cudaa"], r"simulator\.device='cudaa': allowed are auto, cpu, cuda; did you mean cuda\?"),
    (["simulator.device=gpu"], r"simulator\.device='gpu': allowed are auto, cpu, cuda$"),  # no name is that near
    (["probe.kind=lineal"], r"probe\.kind=lineal: allowed are .*; did you mean linear\?"),
    (["hydra/launcher=proceses", "-m"], r"allowed are .*; did you mean processes\?"),
    (["+study=everything"], r"study=everything: allowed are add_one_in, components, compounded, encoding"),
    (["-m", "+study=leave_one_out,table2"], r"\+study=leave_one_out,table2: allowed is one study a command"),
    (["study_name="], r"study_name=''?: allowed are "),  # a shell variable that is not set
    (["dataset.poses="], r"dataset\.poses=''?: allowed are "),
    (["runs_dir="], r"runs_dir=''?: allowed are "),
    (["trainin.steps=3"], r"unknown key 'trainin.*did you mean 'training'"),
    (["-m", "variant=sa2h", "model.labels=1,3"], r"unknown key 'model\.labels'"),  # it follows from `encoding`
    (["training.stepz=3"], r"unknown key 'training.stepz'; did you mean 'training\.steps'\? allowed in training: "),
    (["+colour=blue"], r"unknown key 'colour'"),
    (["reference=sa9h"], r"reference=sa9h: allowed are .*sa2h"),
    (["model.depth=${level:4}"], r"model.depth: Unsupported interpolation type level"),
    (["foo"], r"'foo': allowed are key=value and the options of --help, no blank beside ="),
    (["objective=val/nope"], r"objective=val/nope: allowed are val/psnr, .*test/psnr"),
    (["preset=paper", "evaluation.inception=no.pt", "task=plan"], r"evaluation\.inception=no\.pt: .*no\.pt"),
    (["metrics=fid"], r"metrics=fid: name one that every image has too"),
    (["metrics=[psnr,fid]"], r"metrics=fid: needs evaluation.inception="),
    # Text in place of a name, or a name in place of text.
    (["variant=[1,2]"], r"variant=\[1,2\]: allowed are .*sa2h"),
    (["variant=[sa2h"], r"."),
    # Out of range, or not together.
    (["seed=99999999999999999999"], r"seed=99999999999999999999: allowed are whole numbers below 2\^63"),
    (["simulator.image_shape=[99999,1]"], r"simulator\.image_shape=\[99999, 1\]: .* 2 whole numbers from 1 to 16384"),
    (["training.crop=4096"], r"training\.crop=4096: at most 384, which covers a frame of 384 x 128"),
    (["simulator.scanlines=24"], r"training\.crop=0: whole frames are 384 x 24; allowed are at least 32 x 32"),
    (["dataset.grid=[1,2]"], r"dataset\.grid=\[1, 2\]: allowed are 4 whole numbers from 1, or null"),
    (["probe=matrix"], r"probe=matrix: allowed are c5-2v, convex, l11-5v, linear, p4-2v, phased"),
    (["probe=linear", "probe.radius_mm=50"], r"probe\.radius_mm=50\.0: a linear probe has width_mm, depth_mm"),
    # Jobs.
    (["variant=sa2h,nsa2h"], r"asks for several jobs: add -m"),
    (["hydra/launcher=joblib"], r"hydra/launcher=joblib starts the jobs of a sweep: add -m"),
    (["-m", "hydra/sweeper=mine", "seed=0,1"], r"hydra/sweeper=mine"),
    (["-m", "variant=glob(sa2h*)"], r"variant=glob\(sa2h\*\): allowed are lists and ranges, as variant=sa2h,nsa2h"),
    (["-m", "seed=range(3,0)"], r"seed=range\(3,0\): a sweep without a job"),
    (["-m", "variant=sa2h,"], r"variant: Hydra cannot read the value 'sa2h,'; give it without the comma at its end"),
    # Names and folders.
    (["study_name=.."], r"study_name='\.\.': allowed are at most 200 letters, digits, blanks and _\.\+-"),
    (['study_name="o\'neill"'], r"study_name=.*neill.*: allowed are"),
    (["runs_dir=file", "task=plan"], r"file' is a file; allowed is a folder"),
    ([f"runs_dir={300 * 'x'}"], r"runs_dir='x+\.\.\.x+': File name too long"),
    (["-m", "study_name=été,a"], r"study_name: Hydra cannot read the value 'été,a'; give it in quotes: \"study_name='"),
    (["tracking.uri=nonsense"], r"tracking\.uri='nonsense': allowed are http://, .*sqlite:///"),
    (["metrics=[[psnr]]"], r"metrics=\['psnr'\]: is no name; allowed are"),
    (["metrics=[leaves.f]"], r"metrics=leaves\.f: SystemExit: 0; allowed are"),
    (["variant=custom", "model.target=leaves.F"], r"model\.target=leaves\.F: SystemExit: 0; allowed is"),
    (["dataset.poses=archive.npy"], r"dataset\.poses=archive\.npy: is an archive \(\.npz\), allowed is one array"),
    (["dataset.poses=semicolons.csv"], r"its first line must be x,y,z,qw,qx,qy,qz and, if wanted, site, not x;y;z"),
    (["dataset.poses=site.csv"], r"line 2: allowed are numbers, and whole ones of 32 bits as site, not '.*9999"),
    (["runs_dir='100%/runs'"], r"100%/runs: allowed is a path without %"),
    (["runs_dir='what?/runs'", "task=compare"], r"what\?/runs: allowed is a path without \?"),
    # Scenes and pairs.
    (["scene=folder"], r"scene\.folder"),
    (["scene=pairs", "scene.folder=empty"], r"empty"),
    (["task=preview", "scene=pairs", "scene.folder=empty"], r"task=preview: pairs made elsewhere have no scene"),
    # What decides nothing.
    (["simulator.tgc_db_cm_mhz=0.9"], r"allowed with simulator\.tgc=fixed"),
]


@pytest.mark.parametrize(("arguments", "words"), COMMAND_LINES, ids=[" ".join(a)[:40] for a, _ in COMMAND_LINES])
def test_a_command_line_that_cannot_be_run(
    refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "empty").mkdir()
    (tmp_path / "leaves.py").write_text("raise SystemExit(0)\n")
    monkeypatch.syspath_prepend(tmp_path)
    with (tmp_path / "archive.npy").open("wb") as archive:
        np.savez(archive, poses=np.eye(4)[None])
    (tmp_path / "semicolons.csv").write_text("x;y;z\n0;0;0\n", "utf-8-sig")
    (tmp_path / "site.csv").write_text(f"x,y,z,qw,qx,qy,qz,site\n0,0,0,1,0,0,0,{20 * '9'}\n")
    assert re.search(words, refused(*arguments))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"model:\n\tdepth: 4\n", r"cannot start any token; in .*variant/mine\.yaml\", line 2"),
        (b"a: 1\na: 2\n", r"found duplicate key a; in .*variant/mine\.yaml\", line 2"),
    ],
)
@pytest.mark.parametrize("arguments", [["variant=mine"], ["-m", "variant=mine,sa2h"]], ids=["one", "sweep"])
def test_a_variant_file_that_cannot_be_read(
    refused: Refused, tmp_path: Path, content: bytes, words: str, arguments: list[str]
) -> None:
    folder = tmp_path / "conf" / "variant"
    folder.mkdir(parents=True)
    (folder / "mine.yaml").write_bytes(content)
    assert re.search(words, refused(f"hydra.searchpath=[file://{tmp_path / 'conf'}]", *arguments))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"structures": [{"mesh": "garbage.ply", "tissue": "liver"}]}, "garbage.ply: not readable as a mesh"),
        ({"unit": "m"}, "scene.yaml: unit: m makes the scene's largest extent 1.2e+05 mm"),
        ({"sites": {"heights": {"range": [500, 600], "count": 4}, "tilts": [-5, 0, 5]}}, "12 the direction misses"),
        ({"sites": None}, "no `sites`"),
    ],
)
def test_a_scene_that_cannot_be_used(refused: Refused, tmp_path: Path, changes: dict[str, object], words: str) -> None:
    scene_folder(tmp_path / "scene", **changes)
    assert words in refused("scene=folder", f"scene.folder={tmp_path / 'scene'}", "dataset.frames=12")


@pytest.mark.parametrize(
    "uri",
    ["http://anna:canary@host:5000", "https://canary@host", "'postgresql+psycopg2://anna:can/canary#@host/db'",
     "'mysql://host/db?password=canary'", "http://anna:can,canary@host", "${oc.env:TRACKING}"],
)  # fmt: skip
def test_a_password_in_the_tracking_uri_is_refused_and_not_shown(
    refused: Refused, monkeypatch: pytest.MonkeyPatch, uri: str
) -> None:
    monkeypatch.setenv("TRACKING", "http://anna:canary@host:5000")
    message = refused(f"tracking.uri={uri}")
    assert "canary" not in message
    assert "," in uri or "tracking.uri: holds a user or a password" in message


@pytest.mark.parametrize("task", ["study", "compare"])
def test_a_folder_that_is_read_only_is_refused(
    refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, task: str
) -> None:
    (tmp_path / "runs").mkdir()

    def read_only(dir: Path) -> None:  # root may write anywhere, so a mode would not do
        raise PermissionError(errno.EROFS, os.strerror(errno.EROFS), str(dir))

    monkeypatch.setattr("tempfile.TemporaryFile", read_only)
    assert refused(f"task={task}").endswith("runs cannot be written: Read-only file system")


def keys(cls: type = StudySettings, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Every key of the configuration, with its type."""
    for name, kind in get_type_hints(cls).items():
        if kind == Probe:
            yield from ((f"{prefix}{name}.{key}", float) for key in PROBE_KEYS)
            yield f"{prefix}{name}.kind", ProbeKind
        elif dataclasses.is_dataclass(kind) and isinstance(kind, type):
            yield from keys(kind, f"{prefix}{name}.")
        else:
            yield prefix + name, kind


KEYS = dict(keys())
# A whole number may stand for text, and any text for a path; what `metrics` holds is told by its names.
TAKES_ANY_TEXT = {"metrics"}


@pytest.fixture(scope="module")
def whole() -> DictConfig:
    """A configuration of all keys, composed once; a key is set as Hydra's overrides set it."""
    return composed([])


def take(config: DictConfig, key: str, value: object) -> None:
    with in_one_line():
        OmegaConf.update(config, key, value, merge=True)
        settings_of_config(config)


def refused_value(whole: DictConfig, key: str, value: object) -> str:
    with pytest.raises(ConfigurationError) as error:
        take(copy.deepcopy(whole), key, value)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_value_of_a_wrong_type_is_refused_by_the_name_of_its_key(whole: DictConfig) -> None:
    for key in sorted(KEYS.keys() - TAKES_ANY_TEXT):
        takes_text = KEYS[key] is str or str in getattr(KEYS[key], "__args__", ())
        assert key.rpartition(".")[2] in refused_value(whole, key, ["a", "b"] if takes_text else "wrong")


DEFAULTS = plain(StudySettings())


def with_value(key: str, value: float) -> dict[str, Any]:
    """The paper's settings as plain values, with one of them changed."""
    group, _, name = key.rpartition(".")
    return {**DEFAULTS, group: {**DEFAULTS[group], name: value}} if group else {**DEFAULTS, name: value}


NUMBERS = sorted(key for key, kind in KEYS.items() if kind in (int, float))


@settings(max_examples=300, deadline=None)
@given(key=st.sampled_from(NUMBERS), data=st.data())
def test_any_number_is_taken_or_refused_in_one_line(key: str, data: st.DataObject) -> None:
    numbers = st.integers(-(2**63) + 1, 2**63 - 1) if KEYS[key] is int else st.floats()
    value = data.draw(numbers)
    refusal = ""
    try:
        build(StudySettings, with_value(key, value))
    except ValueError as error:
        refusal = str(error)
    assert key.rpartition(".")[2] in refusal if refusal else math.isfinite(value)
    assert "\n" not in refusal


def test_every_choice_is_named_by_its_refusal(whole: DictConfig) -> None:
    for key, kind in KEYS.items():
        if isinstance(kind, type) and issubclass(kind, Enum):
            message = refused_value(whole, key, "wrong")
            assert all(member.name in message for member in kind), key
