"""What docs/plastic.md shows runs as it is shown."""

import re
from pathlib import Path

import numpy as np

import plastic
from tests.plastic.plastic_trees import grown_tree
from treegraph import TriangleMesh, write_lobes

PAGE = Path(__file__).parents[2] / "docs" / "plastic.md"


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)


def test_the_example_runs(tmp_path, monkeypatch):
    write_lobes(grown_tree(9), tmp_path / "oak.lobes")
    monkeypatch.chdir(tmp_path)
    (example,) = blocks("python")
    names = {}
    exec(compile(example, str(PAGE), "exec"), names)
    adapted = names["adapted"]
    assert adapted.neighbours[0].tree.graph.n_nodes > 1
    assert adapted.tree.graph.position[:, 0].max() < 1.2


def test_the_scene_file_can_be_read(tmp_path):
    (text,) = blocks("toml")
    (tmp_path / "yard.toml").write_text(text)
    mesh = TriangleMesh(np.eye(3), [[0, 1, 2]])
    file = plastic.read_scene(tmp_path / "yard.toml", read_mesh=lambda path: mesh)
    assert len(file.scene.obstacles) == 5
    assert [tree.file.name for tree in file.trees] == ["oak.lobes", "oak.lobes"]
