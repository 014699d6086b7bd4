"""``species``: the library of species, and the builder that makes new ones."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from sapwood.cli import options as o
from sapwood.cli.terminal import Terminal

if TYPE_CHECKING:
    from species.library import Definition, Species

DefinitionFile = Annotated[Path, o.argument("X.toml", "The species' definition.")]
Name = Annotated[str, o.argument("NAME", "Any of its names.")]
Where = Annotated[
    Path | None,
    o.option(
        o.OUTPUT, "--output", "-o", metavar="DIR", help="A library to add it to. (default: beside X.toml)"
    ),
]
Sheet = Annotated[
    Path | None,
    o.option(o.OUTPUT, "--output", "-o", metavar="FILE", help="Contact sheet (.png) or definition (.toml)."),
]
NoSheet = Annotated[bool, o.option(o.OUTPUT, "--no-sheet", help="Do not draw the contact sheet.")]


def species_list(
    library: o.LibraryFolder = None,
    as_json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    version: o.Version = False,
) -> int:
    """List the species of the library.

    \b
    Example:  sapwood species list
              sapwood species list --library my-species --json
    """
    from sapwood.dressing import open_library
    from species.library.catalog import BUILTIN
    from treegraph.errors import InputError

    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    found = open_library(library)
    rows, faults = [], found.faults
    with terminal.progress(len(found.names), "species") as bar:
        for name in found.names:
            bar.say(name)
            try:
                rows.append(_row(found.load(name), found.path(name).parent == BUILTIN))
            except InputError as error:
                faults.append(str(error))
            bar.advance()
    for row in rows:
        kind = f"{row['leaf']} leaves"
        terminal.result(f"{row['name']:20}  {row['latin']:26}  {kind:17}  {row['bytes'] / 1000:4.0f} kB")
    for fault in faults:
        terminal.note(f"left out: {fault}")
    terminal.json("species list", species=rows, faults=faults)
    return 0


def _row(species: Species, builtin: bool) -> dict[str, Any]:
    """What the list says of a species."""
    return {
        "name": species.name,
        "latin": species.definition.latin,
        "bytes": species.n_bytes,
        "branchlets": len(species.branchlets),
        "patches": len(species.patches),
        "leaf": species.definition.leaf.kind,
        "builtin": builtin,
    }


def species_show(
    name: Name,
    output: Sheet = None,
    library: o.LibraryFolder = None,
    renderer: o.RendererOption = o.Renderer.auto,
    force: o.Force = False,
    as_json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    version: o.Version = False,
) -> int:
    """Show what is known of a species; with -o draw its leaves, bark and branchlets, or copy its definition.

    \b
    Example:  sapwood species show willow -o willow.png
              sapwood species show oak -o my-species/rowan.toml
    """
    from sapwood.dressing import open_library
    from sapwood.outputs import check_free, write_whole
    from sapwood.species_pages import species_figures
    from treegraph.errors import InputError

    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    suffix = "" if output is None else output.suffix.lower()
    if output is not None:
        check_free([output], force=force)
        if suffix not in (".png", ".toml"):
            raise InputError(
                f"{output}: the name must end in .png (a contact sheet) or .toml (the definition)."
            )
    species = open_library(library).load(name)
    figures = species_figures(species)
    if output is not None and suffix == ".png":
        _draw(terminal, species, output, renderer.value, force)
    elif output is not None:
        text = species.definition.text
        write_whole(output, lambda part: part.write_text(text, encoding="utf-8"), force=force)
    for key, value in figures.items():
        if value not in (None, [], ""):
            terminal.result(f"{key:18} {_plain(value)}")
    terminal.json("species show", **figures, output=None if output is None else str(output))
    return 0


def species_build(
    definition: DefinitionFile,
    output: Where = None,
    no_sheet: NoSheet = False,
    renderer: o.RendererOption = o.Renderer.auto,
    force: o.Force = False,
    as_json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    version: o.Version = False,
) -> int:
    """Build a species: check X.toml, derive its branchlets, draw its leaves and bark.

    \b
    Example:  sapwood species build my-species/rowan.toml
              reconstruct rowan.laz -o out --species Rowan --library my-species

    It writes X.twigs, what is derived, and X.png, a contact sheet.
    """
    from sapwood.outputs import check_free, write_whole
    from sapwood.species_pages import species_figures
    from species.library import build_species, open_species, read_definition
    from species.library.catalog import DERIVED
    from treegraph.errors import FormatError, InputError

    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    if definition.suffix != ".toml":
        raise InputError(f"{definition}: the name of a species' definition must end in .toml.")
    known = read_definition(definition)
    target = (definition.parent if output is None else output) / definition.name
    twigs, sheet = target.with_suffix(DERIVED), target.with_suffix(".png")
    moved = output is not None and target.resolve() != definition.resolve()
    check_free([twigs] + [sheet] * (not no_sheet) + [target] * moved, force=force)
    _check_name(known, target)
    terminal.warn_of_compiling()
    with terminal.progress(None, f"{known.name}: deriving"):
        try:
            data = build_species(known)
            species = open_species(known, data)
        except (InputError, FormatError) as error:
            raise InputError(f"{definition}: {error}") from error
    write_whole(twigs, lambda path: path.write_bytes(data), force=force)
    files = [twigs]
    if moved:
        write_whole(target, lambda path: path.write_text(known.text, encoding="utf-8"), force=force)
        files.insert(0, target)
    if not no_sheet:
        _draw(terminal, species, sheet, renderer.value, force)
        files.append(sheet)
    terminal.result(
        f"{species.name}: {len(species.branchlets)} branchlets, {len(species.patches)} patches, "
        f"{species.n_bytes / 1000:.0f} kB -> {', '.join(map(str, files))}"
    )
    terminal.json("species build", **species_figures(species), files=[str(path) for path in files])
    return 0


def _check_name(known: Definition, target: Path) -> None:
    """A library has one species of a name."""
    from species.library import Library
    from treegraph.errors import InputError

    if not target.parent.is_dir():
        return
    holder = Library((target.parent,)).holder(known.name)
    if holder is not None and holder.name != target.name:
        raise InputError(f"{target}: {holder.name} there has the name {known.name!r} already; take another.")


def _draw(terminal: Terminal, species: Species, path: Path, renderer: str, force: bool) -> None:
    from sapwood.outputs import write_whole
    from sapwood.species_pages import draw_species

    with terminal.progress(None, f"{species.name}: drawing"):
        write_whole(path, lambda part: draw_species(species, part, renderer=renderer), force=force)


def _plain(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {number:g}" for key, number in value.items())
    if isinstance(value, list):
        return ", ".join(str(part) for part in value)
    return str(value)
