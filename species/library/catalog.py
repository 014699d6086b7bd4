"""Where species are found: the library that comes along, folders of one's own, and what is derived."""

from __future__ import annotations

import os
import tempfile
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
            if not Path(folder).is_dir():
                raise InputError(f"{folder}: there is no such folder of species.")
            for path in sorted(Path(folder).glob("*.toml")):
                try:
                    definition = read_definition(path)
                except (InputError, FormatError) as error:
                    self._faults.append(str(error))
                    continue
                if _plain(definition.name) not in {_plain(name) for name in self._known}:
                    self._known[definition.name] = definition
                    self._paths[definition.name] = path

    @property
    def names(self) -> list[str]:
        """Names of all species, in alphabetical order."""
        return sorted(self._known, key=str.casefold)

    @property
    def faults(self) -> list[str]:
        """What is wrong with files that could not be read, a line each; the others are there."""
        return list(self._faults)

    def path(self, name: str) -> Path:
        """The file of a species; as :meth:`find`."""
        return self._paths[self.find(name).name]

    def find(self, name: str) -> Definition:
        """The definition of a species by any of its names; case, blanks and hyphens do not count.

        Raises
        ------
        InputError
            If there is none; the message suggests the nearest.
        """
        wanted = _plain(name)
        for definition in self._known.values():
            if wanted == _plain(definition.name):
                return definition
        for definition in self._known.values():
            if wanted in {_plain(other) for other in definition.names}:
                return definition
        raise InputError(self._unknown(name))

    def _unknown(self, name: str) -> str:
        of = {_plain(other): definition for definition in self._known.values() for other in definition.names}
        near = get_close_matches(_plain(name), list(of), 1, LIKE)
        if not near:
            return f"there is no species {name!r}; there are {', '.join(self.names)}"
        known = of[near[0]]
        exact = next(other for other in known.names if _plain(other) == near[0])
        meant = repr(exact) if exact == known.name else f"{exact!r} ({known.name})"
        return f"there is no species {name!r}; did you mean {meant}?"

    def load(self, name: str) -> Species:
        """A species with its patches and pictures.

        They are read from ``NAME.twigs`` beside its file, if that belongs to it, else from the user's cache
        (the folder that SAPWOOD_CACHE names, or ``sapwood`` in the system's folder for caches), else
        derived and kept there, if it can be written to.

        Raises
        ------
        InputError
            If there is no such species, or something in its definition cannot be derived.
        """
        definition = self.find(name)
        if definition.name not in self._opened:
            self._opened[definition.name] = _open(definition, self._paths[definition.name])
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
        write_whole(target, data)
    except (InputError, FormatError) as error:
        raise type(error)(f"{os.fspath(path)}: {error}") from error
    except OSError as error:
        raise InputError(f"{target}: the file cannot be written ({error.strerror}).") from None
    return open_species(definition, data), target


def cache_folder() -> Path:
    """Where derived files are kept that cannot lie beside their definition."""
    named = os.environ.get(CACHE_VARIABLE) or os.environ.get("XDG_CACHE_HOME")
    if os.environ.get(CACHE_VARIABLE):
        return Path(str(named))
    home = Path(named) if named else Path(os.path.expanduser("~")) / ".cache"
    if not home.is_absolute() or str(home).startswith("~"):
        home = Path(tempfile.gettempdir())
    return home / "sapwood"


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
    return " ".join(str(name).replace("-", " ").replace("_", " ").split()).casefold()
