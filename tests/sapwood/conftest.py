"""Scans and trees that the tests share, and a way to run the commands in this process."""

import json
from dataclasses import dataclass

import pytest
from sapwood_scans import tree_points, write_las, write_xyz


@pytest.fixture(scope="session")
def scans(tmp_path_factory):
    """A folder with a leafless and a leafy tree as text, the leafless one in map coordinates as LAS."""
    folder = tmp_path_factory.mktemp("scans")
    write_xyz(folder / "bare.xyz", tree_points(leaves=False))
    write_xyz(folder / "leafy.xyz", tree_points(1))
    write_las(folder / "mapped.las", tree_points(leaves=False, foot=(455012.25, 5428007.5, 231.75)))
    return folder


@pytest.fixture(scope="session")
def bare(scans):
    """The leafless tree, reconstructed."""
    import sapwood

    return sapwood.reconstruct(scans / "bare.xyz")


@pytest.fixture(scope="session")
def lobes(bare, tmp_path_factory):
    """Its .lobes file."""
    import treegraph

    path = tmp_path_factory.mktemp("lobes") / "bare.lobes"
    treegraph.write_lobes(bare.tree, path)
    return path


@dataclass
class Run:
    """What a command did."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        return json.loads(self.out)

    @property
    def error(self):
        """The only line on stderr."""
        lines = self.err.splitlines()
        assert len(lines) == 1, self.err
        assert lines[0].startswith("error: "), self.err
        return lines[0].removeprefix("error: ")


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """Run ``reconstruct`` or ``sapwood`` in this process, in an empty folder."""
    from sapwood.cli.main import main

    monkeypatch.chdir(tmp_path)

    def call(program, *arguments):
        capsys.readouterr()
        code = main(program, [str(argument) for argument in arguments])
        said = capsys.readouterr()
        return Run(code, said.out, said.err)

    return call
