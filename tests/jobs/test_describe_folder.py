"""`task=describe` of a folder of meshes without a scene.yaml."""

from pathlib import Path

import pytest
import trimesh

from ablate.anatomy import validate_scene_folder
from ablate.jobs.compose import jobs_of
from ablate.settings.study import ConfigurationError
from ablate.tasks.run_task import describe


def test_a_folder_without_scene_yaml_gets_a_proposal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    jobs = jobs_of(["task=describe", f"scene.folder={tmp_path}"])
    with pytest.raises(ConfigurationError, match=r"has no scene\.yaml and no mesh"):
        describe(jobs)
    trimesh.creation.icosphere(1, radius=60).export(tmp_path / "liver.ply")
    assert describe(jobs) == 0
    (tmp_path / "scene.yaml").write_text(capsys.readouterr().out)
    assert validate_scene_folder(tmp_path).meshes[0][1].name == "liver"
    assert describe(jobs) == 0
    assert "receptive field" in capsys.readouterr().out
