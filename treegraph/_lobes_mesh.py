"""Triangle meshes of the ``.lobes`` format: a walk from face to face over shared edges.

Based on: S. Gumhold, W. Strasser, "Real time compression of triangle mesh connectivity", SIGGRAPH 1998
(the cut-border machine). Departs from it in: gates wait in a queue instead of along one border, and
every symbol is also defined where the mesh is not a manifold, so that any list of faces can be kept.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from treegraph._lobes_bytes import read_varint, varint
from treegraph.errors import FormatError

__all__ = ["MeshReader", "restore", "walk_faces"]

NO_FACE, NEW, AHEAD, BEHIND, BACK = range(5)
"""What lies across a gate: no face, or a face whose third vertex is new, ahead, behind, or named."""


class _Border:
    """Edges that faces have used, and the gates at which the walk waits."""

    def __init__(self) -> None:
        self.used: set[tuple[int, int]] = set()
        self.gates: deque[tuple[int, int]] = deque()
        self.after: dict[int, int] = {}
        self.before: dict[int, int] = {}

    def add(self, a: int, b: int, c: int) -> None:
        """Enter face (a, b, c) and open a gate on the far side of each of its edges."""
        used = self.used
        used.update(((a, b), (b, c), (c, a)))
        for gate in ((b, a), (c, b), (a, c)):
            if gate not in used:
                self.gates.append(gate)
                self.after[gate[0]] = gate[1]
                self.before[gate[1]] = gate[0]

    def next_gate(self) -> tuple[int, int] | None:
        """Take the oldest gate that no face has closed yet; None where there is none."""
        while self.gates:
            gate = self.gates.popleft()
            if gate not in self.used:
                return gate
        return None


def walk_faces(
    faces: NDArray[np.int32], n_vertices: int
) -> tuple[NDArray[np.int64], list[tuple[int, int]], bytes, bytes]:
    """Code a list of faces.

    Parameters
    ----------
    faces : (f, 3) int32
        Vertex indices.
    n_vertices : int
        Number of vertices; some may be in no face.

    Returns
    -------
    number : (v,) int64 ndarray
        ``number[k]`` is the old index of the vertex that the file numbers k.
    reference : list of (int, int)
        For each vertex in the new numbering, the two earlier vertices near which it lies;
        (-1, -1) for the first.
    symbols : bytes
        What lies across each gate.
    names : bytes
        Vertices that no symbol tells, as varints.
    """
    triangles = faces.tolist()
    at_edge: dict[tuple[int, int], list[int]] = {}
    for i in range(len(triangles) - 1, -1, -1):
        a, b, c = triangles[i]
        for edge in ((a, b), (b, c), (c, a)):
            at_edge.setdefault(edge, []).append(i)
    coder = _MeshWriter(triangles, at_edge)
    for i in range(len(triangles)):
        if not coder.done[i]:
            coder.walk_from(i)
    number = np.concatenate(
        [
            np.array(list(coder.rank), np.int64),
            np.setdiff1d(np.arange(n_vertices), faces.ravel(), assume_unique=False),
        ]
    )
    reference = coder.reference + [_previous(k) for k in range(len(coder.reference), n_vertices)]
    return number, reference, bytes(coder.symbols), bytes(coder.names)


def _previous(number: int) -> tuple[int, int]:
    return number - 1, number - 1


class _MeshWriter:
    """One walk over a mesh, writing symbols."""

    def __init__(self, triangles: list[list[int]], at_edge: dict[tuple[int, int], list[int]]) -> None:
        self.triangles = triangles
        self.at_edge = at_edge
        self.done = [False] * len(triangles)
        self.n_left = len(triangles)
        self.rank: dict[int, int] = {}
        self.reference: list[tuple[int, int]] = []
        self.border = _Border()
        self.symbols = bytearray()
        self.names = bytearray()

    def walk_from(self, start: int) -> None:
        """Write the face `start` and all that can be reached from it."""
        rank = self.rank
        for vertex in self.triangles[start]:
            if vertex in rank:
                self.names += varint(len(rank) - rank[vertex])
            else:
                self.names.append(0)
                self._number(vertex, *_previous(len(rank)))
        self._enter(start, *self.triangles[start])
        while self.n_left:
            gate = self.border.next_gate()
            if gate is None:
                return
            self._cross(*gate)

    def _cross(self, a: int, b: int) -> None:
        waiting = self.at_edge.get((a, b), [])
        while waiting and self.done[waiting[-1]]:
            waiting.pop()
        if not waiting:
            self.symbols.append(NO_FACE)
            return
        face = self.triangles[waiting[-1]]
        k = next(k for k in range(3) if face[k] == a and face[k - 2] == b)
        c = face[k - 1]
        rank, border = self.rank, self.border
        if c not in rank:
            self.symbols.append(NEW)
            self._number(c, rank[a], rank[b])
        elif border.after.get(b) == c:
            self.symbols.append(AHEAD)
        elif border.before.get(a) == c:
            self.symbols.append(BEHIND)
        else:
            self.symbols.append(BACK)
            self.names += varint(len(rank) - rank[c])
        self._enter(waiting[-1], a, b, c)

    def _number(self, vertex: int, first: int, second: int) -> None:
        self.rank[vertex] = len(self.rank)
        self.reference.append((first, second))

    def _enter(self, face: int, a: int, b: int, c: int) -> None:
        self.done[face] = True
        self.n_left -= 1
        self.border.add(a, b, c)


class MeshReader:
    """Reads meshes one after the other from the symbols and names of a file."""

    def __init__(self, symbols: bytes, names: bytes) -> None:
        self._symbols = symbols
        self._symbol_at = 0
        self._names = names
        self._name_at = 0

    def read(self, n_vertices: int, n_faces: int) -> tuple[list[tuple[int, int, int]], list[tuple[int, int]]]:
        """Return the faces of the next mesh and the references of its vertices, as `walk_faces` has them."""
        faces: list[tuple[int, int, int]] = []
        reference: list[tuple[int, int]] = []
        border = _Border()
        while len(faces) < n_faces:
            gate = border.next_gate()
            if gate is None:
                a, b, c = self._start_vertices(reference, n_vertices)
            else:
                a, b = gate
                c = self._third_vertex(a, b, border, reference, n_vertices)
                if c < 0:
                    continue
            faces.append((a, b, c))
            border.add(a, b, c)
        reference.extend(_previous(k) for k in range(len(reference), n_vertices))
        return faces, reference

    def finish(self) -> None:
        """Raise if some symbols or names belong to no mesh."""
        left = len(self._symbols) - self._symbol_at, len(self._names) - self._name_at
        if any(left):
            raise FormatError(
                f"the meshes must use up their sections, but {left[0]} bytes of 'symbols' "
                f"and {left[1]} bytes of 'names' are left over; the file is damaged"
            )

    def _start_vertices(self, reference: list[tuple[int, int]], n_vertices: int) -> Iterator[int]:
        for _ in range(3):
            yield self._named(reference, n_vertices, may_be_new=True)

    def _third_vertex(
        self, a: int, b: int, border: _Border, reference: list[tuple[int, int]], n_vertices: int
    ) -> int:
        if self._symbol_at >= len(self._symbols):
            raise FormatError("section 'symbols' ends before the last face; the file is damaged")
        symbol = self._symbols[self._symbol_at]
        self._symbol_at += 1
        if symbol == NEW:
            return _new_vertex(reference, n_vertices, (a, b))
        if symbol == AHEAD:
            return _known(border.after.get(b))
        if symbol == BEHIND:
            return _known(border.before.get(a))
        if symbol == BACK:
            return self._named(reference, n_vertices, may_be_new=False)
        if symbol == NO_FACE:
            return -1
        raise FormatError(f"a symbol of a mesh must be 0 to {BACK}, got {symbol}; the file is damaged")

    def _named(self, reference: list[tuple[int, int]], n_vertices: int, *, may_be_new: bool) -> int:
        back, self._name_at = read_varint(self._names, self._name_at, "section 'names'")
        if back == 0 and may_be_new:
            return _new_vertex(reference, n_vertices, _previous(len(reference)))
        if not 1 <= back <= len(reference):
            raise FormatError(
                f"a face must name one of the {len(reference)} vertices before it, got the {back}th from the "
                "last; the file is damaged"
            )
        return len(reference) - back


def _new_vertex(reference: list[tuple[int, int]], n_vertices: int, near: tuple[int, int]) -> int:
    if len(reference) >= n_vertices:
        raise FormatError(
            f"the faces of a mesh must use at most its {n_vertices} vertices; the file is damaged"
        )
    reference.append(near)
    return len(reference) - 1


def _known(vertex: int | None) -> int:
    if vertex is None:
        raise FormatError("a face must lie at an open edge, but there is none; the file is damaged")
    return vertex


def restore(residual: Iterable[int], reference: list[tuple[int, int]], start: int) -> list[int]:
    """Coordinates of the vertices of one mesh along one axis, in grid steps."""
    values: list[int] = []
    for off, (first, second) in zip(residual, reference, strict=True):
        values.append(off + (start if first < 0 else (values[first] + values[second]) >> 1))
    return values
