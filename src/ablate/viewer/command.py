"""What is seen, as a command line that makes it again."""

import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from ablate.jobs.compose import jobs_of
from ablate.settings.study import SceneKind, StudySettings
from ablate.viewer.state import State

_SECTIONS = ("scene", "probe", "simulator", "dataset")


def render_command(settings: StudySettings, state: State, poses: Path) -> str:
    """The command that renders a file of poses with the scene, probe, settings and seed of a state.

    `settings` are those that the viewer was started with.
    """
    seen = replace(
        settings,
        probe=state.probe,
        simulator=state.simulator,
        dataset=replace(settings.dataset, seed=state.seed),
    )
    return shlex.join(["python", "-m", "ablate", "task=render", f"pose={poses}", *_overrides(seen)])


def data_command(settings: StudySettings, state: State, poses: Path, count: int) -> str:
    """The command that makes a data set of pairs of a file of poses."""
    seen = replace(settings, probe=state.probe, simulator=state.simulator)
    words = ["task=simulate", f"dataset.poses={poses}", f"dataset.frames={count}"]
    return shlex.join(["python", "-m", "ablate", *words, *_overrides(seen)])


def _overrides(settings: StudySettings) -> list[str]:
    """What a command line must say so that it is composed to the same scene, probe and simulator."""
    words = [f"preset={settings.preset}", f"scene={settings.scene.kind}"]
    if settings.scene.kind is SceneKind.folder:
        words.append(f"scene.folder={Path(settings.scene.folder or '').resolve()}")
    if settings.runs_dir != StudySettings.runs_dir:
        words.append(f"runs_dir={settings.runs_dir}")
    (plain,) = jobs_of([*words, "task=describe"])
    return words + [word for section in _SECTIONS for word in _differences(section, settings, plain.settings)]


def _differences(section: str, here: StudySettings, plain: StudySettings) -> Iterator[str]:
    if section == "dataset":
        names = ["seed", "press_mm"]
    else:
        names = [name for name in plain(getattr(here, section)) if name not in ("kind", "folder")]
    for name in names:
        value = getattr(getattr(here, section), name)
        if value != getattr(getattr(plain, section), name):
            yield f"{section}.{name}={_word(plain(value))}"


def _word(value: object) -> str:
    if value is None:
        return "null"
    if isinstance(value, list):
        return f"[{','.join(map(_word, value))}]"
    return str(value).lower() if isinstance(value, bool) else str(value)
