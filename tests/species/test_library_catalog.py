"""Where species are found, and that what is derived of them is never what is wrong."""

import io
import multiprocessing
import os
import shutil

import numpy as np
import pytest
from PIL import Image

from species.library import (
    Library,
    build_species,
    building,
    builtin_library,
    catalog,
    derive_beside,
    find_species,
    open_species,
    parse_definition,
)
from species.library.building import Species, derived_key
from species.library.packing import pack_species, unpack_species
from tests.library_examples import GRAMMAR, species_text
from treegraph.errors import FormatError, InputError


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch, tmp_path):
    """Pictures of 32 pixels, which are drawn at once; a cache of their own."""
    monkeypatch.setattr(building, "PICTURE_SIDE", 32)
    monkeypatch.setenv("SAPWOOD_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def write(folder, file="rowan", **changes):
    folder.mkdir(exist_ok=True)
    path = folder / f"{file}.toml"
    path.write_text(species_text(**changes), encoding="utf-8")
    return path


@pytest.fixture
def mine(tmp_path):
    """A folder with one species."""
    write(tmp_path / "mine")
    return tmp_path / "mine"


@pytest.fixture
def derivations(monkeypatch):
    """How often something is derived."""
    done = []

    def counted(definition):
        done.append(definition.name)
        return build_species(definition)

    monkeypatch.setattr(catalog, "build_species", counted)
    return done


# ---------------------------------------------------------------- names


@pytest.mark.parametrize(
    "name",
    ["Rowan", "rowan", "ROWAN", " rowan ", "Sorbus aucuparia", "sorbus-aucuparia", "SORBUS_AUCUPARIA",
     "mountain ash", "Mountain-Ash", "mountain   ash"],
)  # fmt: skip
def test_a_species_is_found_by_every_name(mine, name):
    library = Library((mine,))
    assert library.find(name).name == "Rowan"
    assert library.path(name) == mine / "rowan.toml"


def test_letters_written_in_two_ways_are_the_same(tmp_path):
    write(tmp_path / "mine", name="Vogelbeerbäume")
    library = Library((tmp_path / "mine",))
    assert library.find("vogelbeerba\u0308ume").name == "Vogelbeerbäume"


@pytest.mark.parametrize(
    "name, text",
    [
        ("rowen", "there is no species 'rowen'; did you mean 'Rowan'?"),
        ("sorbus", "there is no species 'sorbus'; did you mean 'Sorbus aucuparia' (Rowan)?"),
        ("montain ash", "there is no species 'montain ash'; did you mean 'mountain ash' (Rowan)?"),
        ("qqq", "there is no species 'qqq'; there are Elder, Rowan"),
        ("", "there is no species ''; there are Elder, Rowan"),
    ],
)
def test_an_unknown_name_has_the_nearest(mine, name, text):
    write(mine, "elder", name="Elder", latin="Sambucus nigra", also=[])
    with pytest.raises(InputError) as error:
        Library((mine,)).find(name)
    assert str(error.value) == text


def test_a_long_name_is_not_repeated(mine):
    with pytest.raises(InputError) as error:
        Library((mine,)).find("x" * 10_000)
    assert len(str(error.value)) < 200


def test_an_empty_library_says_so(tmp_path):
    (tmp_path / "empty").mkdir()
    library = Library((tmp_path / "empty",))
    assert library.names == [] and library.faults == []
    with pytest.raises(InputError, match="there is no species 'oak'; there are none"):
        library.find("oak")


def test_the_folder_that_is_named_first_is_meant(tmp_path):
    write(tmp_path / "first", what="mine")
    write(tmp_path / "second", what="theirs")
    write(tmp_path / "second", "elder", name="Elder", latin="Sambucus nigra", also=["rowan"])
    library = Library((tmp_path / "first", tmp_path / "second"))
    assert library.names == ["Elder", "Rowan"]
    assert library.find("rowan").what == "mine"
    assert library.path("rowan") == tmp_path / "first" / "rowan.toml"
    assert library.faults == []
    assert library.holder("rowan") == tmp_path / "first" / "rowan.toml"
    assert library.holder("mountain ash") is None


def test_a_name_comes_before_another_species_other_name(tmp_path):
    write(tmp_path / "first", "elder", name="Elder", latin="Sambucus nigra", also=["Rowan"])
    write(tmp_path / "second")
    library = Library((tmp_path / "first", tmp_path / "second"))
    assert library.find("rowan").name == "Rowan"  # else the one in the list could not be had
    for name in library.names:
        assert library.find(name).name == name


def test_two_of_one_name_in_a_folder_are_a_fault(mine):
    write(mine, "sorb", name="ROWAN", latin="Sorbus domestica")
    library = Library((mine,))
    assert library.find("rowan").latin == "Sorbus aucuparia"
    assert library.faults == [f"{mine / 'sorb.toml'}: its name 'ROWAN' is that of rowan.toml too"]


def test_names_are_in_alphabetical_order(tmp_path):
    for name in ("beech", "Ash", "Cedar"):
        write(tmp_path / "mine", name, name=name, latin=f"{name} x", also=[])
    assert Library((tmp_path / "mine",)).names == ["Ash", "beech", "Cedar"]


# ---------------------------------------------------------------- folders


def test_a_broken_file_is_a_fault_and_the_others_are_there(mine):
    (mine / "a.toml").write_text("name = ")
    (mine / "b.toml").write_text(species_text(leaf__kind="round"))
    (mine / "c.toml").mkdir()
    (mine / "d.toml").symlink_to(mine / "nowhere")
    os.mkfifo(mine / "e.toml")
    (mine / "._rowan.toml").write_text("left by a file manager")
    (mine / "notes.txt").write_text("not a species")
    library = Library((mine,))
    assert library.names == ["Rowan"]
    assert [fault.split(": ")[0] for fault in library.faults] == [str(mine / f"{x}.toml") for x in "abcde"]
    assert "not a TOML file" in library.faults[0]
    assert "[leaf] kind must be one of" in library.faults[1]
    library.faults.clear()
    assert len(library.faults) == 5  # a copy was cleared
    with pytest.raises(InputError) as error:
        library.find("elder")
    assert f"; left out (and 4 more): {mine / 'a.toml'}: not a TOML file" in str(error.value)


@pytest.mark.parametrize("name", ["none", "file.txt"])
def test_what_is_no_folder_is_said(tmp_path, name):
    (tmp_path / "file.txt").write_text("x")
    with pytest.raises(InputError, match=f"{name}: there is no such folder of species."):
        Library((tmp_path / name,))
    with pytest.raises(InputError, match="there is no such folder of species."):
        find_species("oak", tmp_path / name)


def test_a_folder_that_cannot_be_read_is_not_an_empty_one(mine, monkeypatch):
    def refuse(folder):
        raise PermissionError(13, "Permission denied", str(folder))

    monkeypatch.setattr(catalog.os, "listdir", refuse)
    with pytest.raises(InputError, match=r"mine: the folder cannot be read \(Permission denied\)."):
        Library((mine,))


def test_ones_own_species_come_before_those_that_come_along(tmp_path):
    oak = builtin_library().find("oak")
    write(tmp_path / "mine", "oak", name="Oak", latin="Quercus robur", what="mine")
    assert find_species("quercus robur", tmp_path / "mine").definition.what == "mine"
    assert builtin_library().find("oak") is oak
    assert find_species("rowan", write(tmp_path / "mine").parent).name == "Rowan"


# ---------------------------------------------------------------- what is derived


def same(one, other):
    assert isinstance(one, Species) and one.n_bytes == other.n_bytes
    assert one.pictures == other.pictures and one.leaf_box == other.leaf_box
    for a, b in zip(one.patches, other.patches, strict=True):
        assert (a.graph.position == b.graph.position).all() and (a.leaves.base == b.leaves.base).all()
        assert (a.dock_position == b.dock_position).all()


def test_a_species_is_derived_once_and_kept(mine, small_pictures, derivations):
    library = Library((mine,))
    first = library.load("rowan")
    assert library.load("Sorbus aucuparia") is first
    key = derived_key(library.find("rowan"))
    assert [path.name for path in small_pictures.iterdir()] == [f"{key}.twigs"]
    same(Library((mine,)).load("rowan"), first)
    assert derivations == ["Rowan"]
    assert sorted(os.listdir(mine)) == ["rowan.toml"]  # nothing is written where the user did not ask for it


def test_what_lies_beside_is_taken_first(mine, small_pictures, derivations):
    species, path = derive_beside(mine / "rowan.toml")
    assert path == mine / "rowan.twigs"
    assert derivations == ["Rowan"]
    same(Library((mine,)).load("rowan"), species)
    assert derivations == ["Rowan"] and not small_pictures.exists()


def test_what_belongs_to_an_older_definition_is_derived_anew(mine, derivations):
    derive_beside(mine / "rowan.toml")
    before = (mine / "rowan.twigs").read_bytes()
    write(mine, branchlets__count=5)
    found = Library((mine,)).load("rowan")
    assert len(found.branchlets) == 5
    assert derivations == ["Rowan", "Rowan"]
    assert (mine / "rowan.twigs").read_bytes() == before


def test_a_remark_makes_it_stale_too(mine, derivations):
    derive_beside(mine / "rowan.toml")
    with (mine / "rowan.toml").open("a") as file:
        file.write("# a remark\n")
    Library((mine,)).load("rowan")
    assert len(derivations) == 2


def test_what_an_older_builder_made_is_derived_anew(mine, monkeypatch, derivations):
    derive_beside(mine / "rowan.toml")
    monkeypatch.setattr(building, "BUILDER", building.BUILDER + 1)
    Library((mine,)).load("rowan")
    assert len(derivations) == 2


def swapped(definition, data, **changes):
    packed = unpack_species(data)
    values = {
        "key": packed.key, "branchlets": packed.branchlets, "pictures": packed.pictures,
        "leaf_box": packed.leaf_box, "bark_tile": packed.bark_tile, **changes,
    }  # fmt: skip
    return pack_species(**values)


def damage(kind, definition, data):
    if kind == "a bit":
        return data[:500] + bytes([data[500] ^ 1]) + data[501:]
    if kind == "cut":
        return data[: len(data) // 2]
    if kind == "empty":
        return b""
    if kind == "other":
        return b"%PDF-1.4"
    packed = unpack_species(data)
    if kind == "no bark":
        pictures = {name: value for name, value in packed.pictures.items() if name != "bark"}
        return swapped(definition, data, pictures=pictures)
    if kind == "a season too many":
        return swapped(definition, data, pictures=packed.pictures | {"leaf_winter": b"RIFF"})
    if kind == "fewer branchlets":
        return swapped(definition, data, branchlets=packed.branchlets[:-1])
    assert kind == "another key"
    return swapped(definition, data, key="00" * 32)


@pytest.mark.parametrize(
    "kind",
    ["a bit", "cut", "empty", "other", "no bark", "a season too many", "fewer branchlets", "another key"],
)
@pytest.mark.parametrize("where", ["beside", "cache"])
def test_what_is_damaged_is_derived_anew(mine, small_pictures, derivations, kind, where):
    good, beside = derive_beside(mine / "rowan.toml")
    definition = Library((mine,)).find("rowan")
    path = beside
    if where == "cache":
        small_pictures.mkdir()
        path = small_pictures / f"{derived_key(definition)}.twigs"
        beside.rename(path)
    bad = damage(kind, definition, path.read_bytes())
    path.write_bytes(bad)
    with pytest.raises(FormatError):
        open_species(definition, bad)
    derivations.clear()
    same(Library((mine,)).load("rowan"), good)
    assert derivations == ["Rowan"]
    if where == "cache":  # mended
        same(Library((mine,)).load("rowan"), good)
        assert derivations == ["Rowan"]


def test_a_folder_in_the_place_of_the_derived_file_does_no_harm(mine, derivations):
    (mine / "rowan.twigs").mkdir()
    assert Library((mine,)).load("rowan").name == "Rowan"
    assert derivations == ["Rowan"]


def test_neither_beside_nor_in_the_cache_can_be_written(mine, small_pictures, monkeypatch, derivations):
    small_pictures.write_text("a file where the folder should be")
    mine.chmod(0o555)
    try:
        one, other = Library((mine,)).load("rowan"), Library((mine,)).load("rowan")
    finally:
        mine.chmod(0o755)
    same(one, other)
    assert len(derivations) == 2
    assert small_pictures.read_text() == "a file where the folder should be"


def test_a_full_disk_leaves_nothing_behind(mine, small_pictures, monkeypatch, derivations):
    def fill(path, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(catalog, "write_whole", fill)
    assert Library((mine,)).load("rowan").name == "Rowan"
    with pytest.raises(
        InputError, match=r"rowan.twigs: the file cannot be written \(No space left on device\)."
    ):
        derive_beside(mine / "rowan.toml")


@pytest.mark.parametrize(
    "changes, text",
    [
        ({"branchlets__grammar": "axiom = ["}, "[branchlets] grammar, line 1, column "),
        ({"branchlets__grammar": GRAMMAR.replace("L(", "K(")}, "[branchlets] grammar, line "),
        (
            {"branchlets__grammar": GRAMMAR.replace("F(0.05)", "F(1 / (n - n))")},
            "[branchlets] branchlet 1 of 4, line ",
        ),
        (
            {"leaf__length": 8, "leaf__width": 0.0005, "leaf__petiole": 0},
            "[leaf] its picture of 32 pixels is all but empty",
        ),
    ],
)
def test_what_cannot_be_derived_is_said_with_its_file(mine, small_pictures, changes, text):
    path = write(mine, **changes)
    library = Library((mine,))
    with pytest.raises(InputError) as error:
        library.load("rowan")
    assert str(error.value).startswith(f"{path}: {text}")
    with pytest.raises(InputError) as error:
        derive_beside(path)
    assert str(error.value).startswith(f"{path}: {text}")
    assert os.listdir(mine) == ["rowan.toml"] and not small_pictures.exists()


def test_a_species_that_gets_too_large_is_refused(mine, monkeypatch):
    monkeypatch.setattr(building, "MOST_SPECIES_BYTES", 2000)
    with pytest.raises(InputError, match=r"the species takes \d+ kB, more than 2: derive fewer or smaller"):
        Library((mine,)).load("rowan")


def test_its_size_is_that_of_both_files(mine):
    species, path = derive_beside(mine / "rowan.toml")
    assert species.n_bytes == path.stat().st_size + (mine / "rowan.toml").stat().st_size


def _load(folder, go, out):
    building.PICTURE_SIDE = 32
    go.wait()
    species = Library((folder,)).load("rowan")
    out.put([patch.graph.position.tobytes() for patch in species.patches])


def test_two_processes_at_once_get_the_same(mine, small_pictures):
    context = multiprocessing.get_context("fork")
    go, out = context.Event(), context.Queue()
    both = [context.Process(target=_load, args=(mine, go, out)) for _ in range(2)]
    for process in both:
        process.start()
    go.set()
    results = [out.get(timeout=60) for _ in both]
    for process in both:
        process.join(timeout=60)
        assert process.exitcode == 0
    assert results[0] == results[1]
    assert len(os.listdir(small_pictures)) == 1  # and no temporary file


# ---------------------------------------------------------------- the cache's place


@pytest.mark.parametrize(
    "variables, place",
    [
        ({"SAPWOOD_CACHE": "/a/b"}, "/a/b"),
        ({"SAPWOOD_CACHE": "/a/b", "XDG_CACHE_HOME": "/x"}, "/a/b"),
        ({"SAPWOOD_CACHE": "~/c"}, "/h/me/c"),
        ({"SAPWOOD_CACHE": ""}, "/h/me/.cache/sapwood"),
        ({"XDG_CACHE_HOME": "/x"}, "/x/sapwood"),
        ({"XDG_CACHE_HOME": "x/y"}, "/h/me/.cache/sapwood"),  # the standard: relative ones are ignored
        ({"XDG_CACHE_HOME": ""}, "/h/me/.cache/sapwood"),
        ({}, "/h/me/.cache/sapwood"),
        ({"HOME": "somewhere"}, "/tmp/t/sapwood"),
    ],
)
def test_where_derived_files_are_kept(monkeypatch, variables, place):
    for name in ("SAPWOOD_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(catalog.tempfile, "gettempdir", lambda: "/tmp/t")
    for name, value in {"HOME": "/h/me", **variables}.items():
        monkeypatch.setenv(name, value)
    assert str(catalog.cache_folder()) == place


# ---------------------------------------------------------------- pictures


@pytest.fixture
def rowan(mine):
    return Library((mine,)).load("rowan")


def test_pictures_are_those_of_the_seasons_with_leaves(rowan, tmp_path):
    assert set(rowan.pictures) == {
        "leaf_spring", "leaf_summer", "leaf_autumn", "leaf_normal", "bark", "bark_normal",
    }  # fmt: skip
    for name in rowan.pictures:
        channels = 4 if name in ("leaf_spring", "leaf_summer", "leaf_autumn") else 3
        assert rowan.picture(name).shape[2] == channels and rowan.picture(name).dtype == np.uint8
    with pytest.raises(
        InputError, match="Rowan has no picture 'leaf_winter'; it has leaf_spring, leaf_summer"
    ):
        rowan.picture("leaf_winter")
    write(tmp_path / "green", leaf_colors__winter=[60, 90, 40])
    assert "leaf_winter" in Library((tmp_path / "green",)).load("rowan").pictures


def test_the_share_of_the_leaf_is_what_its_picture_shows(rowan):
    left, bottom, right, top = rowan.leaf_box
    there = (rowan.picture("leaf_summer")[..., 3] >= 128).mean()
    area = there * (right - left) * (top - bottom)  # m2 of a leaf of the length in the definition
    assert rowan.leaf_share == pytest.approx(area / (0.08 * (right - left)))
    assert 0.4 < area / (0.08 * 0.04) < 0.9  # of the box around the blade
    box = rowan.box
    assert box[2] - box[0] == pytest.approx(1.0) and box[0] < 0.0 < box[2]
    assert (box[1], box[3]) == pytest.approx((bottom / 0.08, top / 0.08))


def webp(shape, **options):
    out = io.BytesIO()
    pixels = np.random.default_rng(0).integers(0, 255, shape, dtype=np.uint8)
    Image.fromarray(pixels).save(out, "WEBP", **options)
    return out.getvalue()


@pytest.mark.parametrize("shape", [(10, 300, 3), (77, 1000, 4), (1, 1, 3), (33, 2, 4)])
@pytest.mark.parametrize("options", [{}, {"lossless": True}, {"exact": True, "quality": 85}])
def test_the_size_of_a_picture_is_known_before_it_is_read(shape, options):
    data = webp(shape, **options)
    assert building._webp_size(data) == (shape[1], shape[0])
    assert building._pixels(data, "RGBA").shape == (*shape[:2], 4)


def huge(kind):
    """A WebP file that claims to be 16384 x 16384."""
    if kind == "VP8X":
        body = bytes([16, 0, 0, 0]) + (16383).to_bytes(3, "little") * 2
    elif kind == "VP8L":
        body = b"\x2f" + (16383 | 16383 << 14).to_bytes(4, "little") + b"\0" * 5
    else:
        body = b"\x10\0\0\x9d\x01\x2a" + (16383).to_bytes(2, "little") * 2
    chunk = kind.ljust(4).encode() + len(body).to_bytes(4, "little") + body
    return b"RIFF" + (4 + len(chunk)).to_bytes(4, "little") + b"WEBP" + chunk


@pytest.mark.parametrize(
    "data, text",
    [
        (b"", "a picture must be a WebP file"),
        (b"\x89PNG\r\n\x1a\n" + b"\0" * 40, "a picture must be a WebP file"),
        (b"RIFF\0\0\0\0WEBPALPH" + b"\0" * 40, "a picture must be a WebP file"),
        (webp((40, 40, 3))[:29], "a picture must be a WebP file"),
        (webp((40, 40, 3))[:60], "a picture cannot be read"),
        (webp((40, 40, 4), lossless=True)[:200], "a picture cannot be read"),
        (huge("VP8X"), "a picture has more than 2048 pixels a side"),
        (huge("VP8L"), "a picture has more than 2048 pixels a side"),
        (huge("VP8"), "a picture has more than 2048 pixels a side"),
    ],
)
def test_a_picture_is_read_without_trust(rowan, data, text):
    wrong = Species(
        rowan.definition, rowan.branchlets, rowan.patches, rowan.pictures | {"bark": data},
        rowan.leaf_box, rowan.bark_tile, 0,
    )  # fmt: skip
    with pytest.raises(FormatError, match=f"{text}.*the file is damaged"):
        wrong.picture("bark")


def test_a_species_says_what_it_has(rowan):
    assert (
        repr(rowan)
        == f"<Species Rowan: 4 branchlets, {len(rowan.patches)} patches, {rowan.n_bytes / 1000:.0f} kB>"
    )


def test_a_definition_from_memory_is_derived_like_that_of_a_file(mine, rowan):
    definition = parse_definition(species_text())
    same(open_species(definition, build_species(definition)), rowan)
    assert build_species(definition) == build_species(definition)


def test_a_library_can_be_moved(mine, tmp_path, derivations):
    derive_beside(mine / "rowan.toml")
    shutil.move(mine, tmp_path / "elsewhere")
    Library((tmp_path / "elsewhere",)).load("rowan")
    assert len(derivations) == 1
