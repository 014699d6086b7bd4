"""The transformation once more, slow and obvious: dictionaries, recursion, one call of the light per site."""

import math
from types import SimpleNamespace

import numpy as np

from plastic import lean_of
from plastic._plans import GRAIN, STEP
from species._growth_kernels import blocked
from treegraph import Ball, Box, HalfSpace, Leaves, Occluders, gather_light

ROOT = -1


def steps(value, base):
    """From the base in whole steps, as light is rounded."""
    return base + STEP * np.floor((value - base) / STEP + 0.5)


def grains(offset, grain):
    return grain * np.floor(offset / grain + 0.5)


def shifted(obstacle, by):
    """The same obstacle somewhere else."""
    if isinstance(obstacle, HalfSpace):
        return HalfSpace(obstacle.point + by, obstacle.normal, obstacle.translucency)
    if isinstance(obstacle, Ball):
        return Ball(obstacle.center + by, obstacle.radius, obstacle.translucency)
    return Box(obstacle.center + by, obstacle.size, obstacle.rotation, obstacle.translucency)


def enters(obstacles, start, end):
    """Whether the way from start to end leads into an obstacle, by the growth model's own rule."""
    planes = [(*o.point, *o.normal, o.translucency) for o in obstacles if isinstance(o, HalfSpace)]
    balls = [(*o.center, o.radius, o.translucency) for o in obstacles if isinstance(o, Ball)]
    boxes = [
        (*o.center, *np.asarray(o.rotation).T.ravel(), *o.size / 2, o.translucency)
        for o in obstacles
        if isinstance(o, Box)
    ]
    rows = [np.array(r).reshape(-1, width) for r, width in ((planes, 7), (balls, 5), (boxes, 16))]
    return blocked(*start, *end, *rows)


def rotation_between(a, b):
    """The shortest rotation from one unit vector to another (Rodrigues)."""
    axis = np.cross(a, b)
    sine, cosine = np.linalg.norm(axis), float(a @ b)
    if sine < 1e-12:
        return np.eye(3) if cosine > 0 else 2 * np.outer(*[np.array([1.0, 0, 0])] * 2) - np.eye(3)
    x, y, z = axis / sine
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = math.atan2(sine, cosine)
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


class Reference:
    """One tree in one scene."""

    def __init__(self, state, scene):
        self.state, self.scene = state, scene
        graph = state.tree.graph
        self.parent, self.before, self.birth = graph.parent, graph.position, state.seasons.birth
        n = graph.n_nodes
        self.kids = {i: np.flatnonzero(graph.parent == i).tolist() for i in range(n)}
        self.position = {i: graph.position[i] for i in range(n)}
        self.turn = {i: np.eye(3) for i in range(n)}
        self.cause = dict.fromkeys(range(n), 0)
        self.light = {}
        segment = np.where(graph.parent[:, None] >= 0, graph.position - graph.position[graph.parent], 0.0)
        self.length = np.linalg.norm(segment, axis=1)
        toward = np.where(state.crown.look[:, None] >= 0, state.toward[state.crown.look], 0.0)
        keep, self.lean = lean_of(state.settings.tropisms, toward, self.length, state.seasons.internode)
        self.pull = state.settings.tropisms.light_share * (1 - keep)

    def seats(self, s):
        first = self.state.crown.seat_first
        return self.state.crown.seat[first[s] : first[s + 1]].tolist()

    def living(self, nodes):
        return [i for i in nodes if not self.cause[i]]

    def look(self, group):
        """Light at all sites of a group: each one's clusters against each other, obstacles in space."""
        crown, state = self.state.crown, self.state
        sites = range(crown.first[group], crown.first[group + 1])
        offset = {}
        for s in sites:
            alive = self.living(self.seats(s)) if group else self.seats(s)
            moves = [self.position[i] - self.before[i] for i in alive]
            offset[s] = (np.mean(moves, axis=0), len(alive)) if alive else (np.zeros(3), 0)
        mean = [move for move, n in offset.values() if n]
        mean = np.mean(mean, axis=0) if mean else np.zeros(3)
        local, center, shading = {}, {}, []
        for s in sites:
            move, n = offset[s]
            local[s] = center[s] = crown.center[s]
            if n and group and any(self.moved_at_all()):
                grain = GRAIN * crown.radius[s]
                local[s] = local[s] + grains(move - mean, grain)
                center[s] = center[s] + grains(move, grain)
            if n and group:
                shading.append(s)
        gamma = [
            state.settings.unit_translucency ** (crown.radius[s] * offset[s][1] / len(self.seats(s)))
            for s in shading
        ]
        leaves = Leaves(
            np.array([local[s] for s in shading]).reshape(-1, 3), crown.radius[shading], np.array(gamma)
        )
        sky = self.scene.sky or state.sky
        for s in sites:
            things = tuple(shifted(o, local[s] - center[s]) for o in self.scene.obstacles)
            own = [shading.index(s) if s in shading else -1]
            found = gather_light(
                [local[s]], Occluders(leaves, obstacles=things), sky, own=own, rings=state.settings.rings
            )
            direction = np.nan_to_num(found.direction[0])
            change = steps(direction, state.toward[s]) - state.toward[s] if direction.any() else np.zeros(3)
            self.light[s] = (max(0.0, steps(found.amount[0], state.light[s])), change)

    def moved_at_all(self):
        return (
            bool(self.cause[i]) or not np.array_equal(self.position[i], self.before[i]) for i in self.kids
        )

    def bend(self, season):
        """Segments of a season, parents first (Eq. 4.6)."""
        for i in np.flatnonzero(self.birth == season):
            p = self.parent[i]
            if p < 0:
                continue
            if self.cause[p]:
                self.cause[i] = self.cause[p]
                continue
            change = self.light[self.state.crown.look[i]][1] if self.state.crown.look[i] >= 0 else np.zeros(3)
            turned = not np.array_equal(self.turn[p], np.eye(3))
            if turned or change.any():
                h = self.turn[p] @ self.state.rest[i] + self.lean[i]
                h = h + self.scene.bending * self.pull[i] * change
                heading = self.heading(i)
                was = self.turn[p] @ heading
                h = h / np.linalg.norm(h)
                self.turn[i] = rotation_between(was, h) @ self.turn[p]
                self.position[i] = self.position[p] + self.length[i] * h
            if enters(self.scene.obstacles, self.position[p], self.position[i]):
                self.cause[i] = 2

    def heading(self, i):
        p = self.parent[i]
        if p < 0:
            return np.array([0.0, 0.0, 1.0])
        if self.length[i] == 0.0:
            return self.heading(p) if self.parent[p] >= 0 else np.array([0.0, 0.0, 1.0])
        return (self.before[i] - self.before[p]) / self.length[i]

    def prune(self, season):
        """From the tips to the root: what falls does not count below."""
        crown = self.state.crown
        own = dict.fromkeys(self.kids, 0.0)
        for s in range(crown.first[season + 1], crown.first[season + 2]):
            for i in self.seats(s):
                own[i] += 2 * np.pi * crown.radius[s] ** 2 / len(self.seats(s)) * self.light[s][0]
        fallen = []

        def weigh(i):
            zeta, total = own[i], self.length[i]
            for j in self.kids[i]:
                if self.birth[j] <= season and not self.cause[j]:
                    more = weigh(j)
                    zeta, total = zeta + more[0], total + more[1]
            least = self.scene.pruning * self.state.pruning_least[i]
            if self.parent[i] >= 0 and zeta < (1 - 1e-12) * least * total:
                fallen.append(i)
                return 0.0, 0.0
            return zeta, total

        for root in np.flatnonzero(self.parent < 0):
            weigh(root)
        for i in fallen:
            self.let_die(i, season)

    def let_die(self, i, season):
        for j in self.kids[i]:
            if self.birth[j] <= season and not self.cause[j]:
                self.let_die(j, season)
        self.cause[i] = 1


def adapt_slowly(state, scene):
    """The tree in a scene without neighbours and meshes."""
    tree = Reference(state, scene)
    tree.look(0)
    for season in range(state.seasons.count):
        tree.bend(season)
        tree.look(season + 1)
        tree.prune(season)
    n = len(tree.parent)
    cause = np.array([tree.cause[i] for i in range(n)])
    position = np.array([tree.before[i] if cause[i] else tree.position[i] for i in range(n)])
    last = range(state.crown.first[-2], state.crown.first[-1])
    return SimpleNamespace(
        position=position, cause=cause, alive=cause == 0, light=np.array([tree.light[s][0] for s in last])
    )
