"""Where species are found: the library that comes along, folders of one's own, and what is derived."""

from __future__ import annotations

import os
import tempfile
import unicodedata
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cache
from pathlib import Path

from species.library.building import Species, build_species, derived_key, open_species
from species.library.definition import Definition, read_definition
from species.library.packing import MOST_BYTES
from treegraph._files import write_whole
from treegraph.errors import FormatError, InputError

__all__ = ["DERIVED", "Library", "builtin_library", "derive_beside", "find_species"]

DERIVED = ".twigs"
"""Suffix of the file that is derived of NAME.toml and kept beside it."""
BUILTIN = Path(__file__).parent / "kinds"
CACHE_VARIABLE = "SAPWOOD_CACHE"
LIKE = 0.5  # how like a name has to be to be suggested, 0 to 1
LONGEST_SHOWN = 80  # characters of a name that is not known


@dataclass(frozen=True, eq=False)
class Library:
    """Folders of species; where two have the same name, that of the first folder is meant.

    Attributes
    ----------
    folders : tuple of Path
        Each with files NAME.toml.
    """

    folders: tuple[Path, ...]
    _known: dict[str, Definition] = field(default_factory=dict, repr=False)
    _opened: dict[str, Species] = field(default_factory=dict, repr=False)
    _faults: list[str] = field(default_factory=list, repr=False)
    _paths: dict[str, Path] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        for folder in self.folders:
            for path in _files_of(Path(folder)):
                try:
                    self._add(path, read_definition(path))
                except (InputError, FormatError) as error:
                    self._faults.append(str(error))

    def _add(self, path: Path, definition: Definition) -> None:
        """Take a species in, unless a folder before has one of its name."""
        holder = self.holder(definition.name)
        if holder is None:
            self._known[definition.name] = definition
            self._paths[definition.name] = path
        elif holder.parent == path.parent:
            raise InputError(f"{path}: its name {definition.name!r} is that of {holder.name} too")

    @property
    def names(self) -> list[str]:
        """Names of all species, in alphabetical order."""
        return sorted(self._known, key=str.casefold)

    @property
    def faults(self) -> list[str]:
        """What is wrong with files that could not be read, a line each; the others are there."""
        return list(self._faults)

    def holder(self, name: str) -> Path | None:
        """The file of the species that is called so, other names left aside; None if there is none."""
        return next((path for known, path in self._paths.items() if _plain(known) == _plain(name)), None)

    def path(self, name: str) -> Path:
        """The file of a species; as :meth:`find`."""
        return self._paths[self.find(name).name]

    def find(self, name: str) -> Definition:
        """The definition of a species by any of its names; case, blanks and hyphens do not count.

        The name of one comes before another name of another, whatever their folders.

        Raises
        ------
        InputError
            If there is none; the message suggests the nearest, and says which files could not be read.
        """
        wanted = _plain(name)
        for definition in self._known.values():
            if wanted == _plain(definition.name):
                return definition
        for definition in self._known.values():
            if wanted in {_plain(other) for other in definition.names}:
                return definition
        text = f"there is no species {str(name)[:LONGEST_SHOWN]!r}{self._hint(name)}"
        if self._faults:
            more = f" (and {len(self._faults) - 1} more)" if len(self._faults) > 1 else ""
            text += f"; left out{more}: {self._faults[0]}"
        raise InputError(text)

    def _hint(self, name: str) -> str:
        of = {_plain(other): definition for definition in self._known.values() for other in definition.names}
        near = get_close_matches(_plain(name)[:LONGEST_SHOWN], list(of), 1, LIKE)
        if not near:
            return f"; there are {', '.join(self.names)}" if self._known else "; there are none"
        known = of[near[0]]
        exact = next(other for other in known.names if _plain(other) == near[0])
        return f"; did you mean {exact!r}{'' if exact == known.name else f' ({known.name})'}?"

    def load(self, name: str) -> Species:
        """A species with its patches and pictures.

        They are read from ``NAME.twigs`` beside its file, if that belongs to it, else from the user's cache
        (the folder that SAPWOOD_CACHE names, or ``sapwood`` in the system's folder for caches), else
        derived and kept there, if it can be written to.

        Raises
        ------
        InputError
            If there is no such species, or something in its definition cannot be derived; then the message
            begins with its file.
        """
        definition = self.find(name)
        if definition.name not in self._opened:
            path = self._paths[definition.name]
            try:
                self._opened[definition.name] = _open(definition, path)
            except (InputError, FormatError) as error:
                raise InputError(f"{path}: {error}") from error
        return self._opened[definition.name]


@cache
def builtin_library() -> Library:
    """The species that come along."""
    return Library((BUILTIN,))


def find_species(name: str, folder: str | os.PathLike[str] | None = None) -> Species:
    """A species of the library, with its patches and pictures.

    Parameters
    ----------
    name : str
        Any of its names.
    folder : path, optional
        A library of one's own, which is looked into first.

    Raises
    ------
    InputError
        If there is none; the message suggests the nearest.
    """
    library = builtin_library() if folder is None else Library((Path(folder), BUILTIN))
    return library.load(name)


def derive_beside(path: str | os.PathLike[str]) -> tuple[Species, Path]:
    """Derive a species and write the derived file beside its definition.

    Raises
    ------
    InputError, FormatError
        If the definition is at fault, or the file cannot be written; the message begins with the path.
    """
    definition = read_definition(path)
    target = Path(path).with_suffix(DERIVED)
    try:
        data = build_species(definition)
        species = open_species(definition, data)
        write_whole(target, data)
    except (InputError, FormatError) as error:
        raise InputError(f"{os.fspath(path)}: {error}") from error
    except OSError as error:
        raise InputError(f"{target}: the file cannot be written ({error.strerror}).") from None
    return species, target


def cache_folder() -> Path:
    """Where derived files are kept that cannot lie beside their definition."""
    named = os.environ.get(CACHE_VARIABLE)
    if named:
        return Path(os.path.expanduser(named))
    base = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(base):  # its standard says to leave another alone
        return Path(base) / "sapwood"
    home = os.path.expanduser("~")
    if os.path.isabs(home):
        return Path(home) / ".cache" / "sapwood"
    return Path(tempfile.gettempdir()) / "sapwood"


def _files_of(folder: Path) -> list[Path]:
    """The definitions in a folder, in alphabetical order."""
    try:
        names = sorted(os.listdir(folder))
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{folder}: there is no such folder of species.") from None
    except OSError as error:
        raise InputError(f"{folder}: the folder cannot be read ({error.strerror}).") from None
    return [folder / name for name in names if name.endswith(".toml") and not name.startswith(".")]


def _open(definition: Definition, path: Path) -> Species:
    kept = cache_folder() / f"{derived_key(definition)}{DERIVED}"
    for candidate in (path.with_suffix(DERIVED), kept):
        try:
            with open(candidate, "rb") as file:
                return open_species(definition, file.read(MOST_BYTES + 1))
        except (OSError, FormatError):  # not there, of another definition, or damaged: derived anew
            continue
    data = build_species(definition)
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        write_whole(kept, data)
    except OSError:  # a disk that is full or read-only: it is derived again next time
        pass
    return open_species(definition, data)


def _plain(name: str) -> str:
    """A name without what does not count."""
    text = unicodedata.normalize("NFKC", str(name)).casefold()
    return " ".join(text.replace("-", " ").replace("_", " ").split())
