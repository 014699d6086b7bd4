"""Files that appear whole or not at all: written beside their place, then renamed."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType

from treegraph.errors import InputError

__all__ = ["Staging", "check_free", "make_folder", "write_whole"]

_PREFIX = ".sapwood-"


class Staging:
    """A hidden folder inside `folder` in which outputs are made, and from which they are published.

    Leaving the ``with`` block, however that happens, removes the hidden folder and what is still in it.

    Leaving it also removes `folder` and those above it that entering made, if nothing was published there.

    Parameters
    ----------
    folder : path
        Where the finished files go; made if it is not there.
    inside : path, optional
        Where the hidden folder is made; on the same disk as `folder`, which it is by default.

    Raises
    ------
    InputError
        On entering, if `folder` cannot be made or written to.
    """

    def __init__(
        self, folder: str | os.PathLike[str], *, inside: str | os.PathLike[str] | None = None
    ) -> None:
        self.folder = Path(folder)
        self.path = self.folder
        self._inside = self.folder if inside is None else Path(inside)
        self._made: list[Path] = []

    def __enter__(self) -> Staging:
        above = [self.folder, *self.folder.parents]
        self._made = [folder for folder in above if not folder.exists()]  # the deepest first
        make_folder(self.folder)
        try:
            self.path = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=self._inside))
        except OSError as error:
            raise InputError(
                f"{self.folder}: cannot write here ({error.strerror}); name another folder."
            ) from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        shutil.rmtree(self.path, ignore_errors=True)
        with contextlib.suppress(OSError):  # there is something in it
            for folder in self._made:
                folder.rmdir()

    def publish(self, names: Iterable[str]) -> list[Path]:
        """Move finished files to their place, replacing what is there; in the order given."""
        published = []
        for name in names:
            target = self.folder / name
            os.replace(self.path / name, target)
            published.append(target)
        return published


def make_folder(folder: Path) -> None:
    """Make `folder` and its parents unless they are there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise InputError(f"{folder}: this is a file, not a folder; name another one.") from None
    except NotADirectoryError:
        raise InputError(
            f"{folder}: a part of this path is a file, not a folder; name another one."
        ) from None
    except OSError as error:
        raise InputError(
            f"{folder}: the folder cannot be made ({error.strerror}); name another one."
        ) from None


def check_free(paths: Iterable[Path], *, force: bool) -> None:
    """Raise InputError if one of `paths` exists and must not be overwritten."""
    for path in paths:
        if path.is_dir():
            raise InputError(f"{path}: this is a folder; name a file to write.")
        if not force and path.exists():
            raise InputError(
                f"{path}: the file exists already; overwrite it with --force, or name another place."
            )


def write_whole(
    path: str | os.PathLike[str], write: Callable[[Path], object], *, force: bool = False
) -> Path:
    """Have ``write(temporary path)`` make a file, then move it to `path`; the suffix stays the same.

    Other files that it makes beside the temporary one (the ``.mtl`` of an ``.obj``) move along.

    Raises
    ------
    InputError
        If `path` exists and `force` is not set, or cannot be written to.
    """
    path = Path(path)
    check_free([path], force=force)
    with Staging(path.parent) as staging:
        write(staging.path / path.name)
        names = sorted({*os.listdir(staging.path)} - {path.name})
        check_free([path.parent / name for name in names], force=force)
        staging.publish([*names, path.name])
    return path
