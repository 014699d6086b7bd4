"""The growth model as docs/growth.md has it, slow and obvious: objects, lists, sums over pairs.

Only the names of the settings and the scheme of the keys (what is hashed in which order) are taken from the
compiled model. Light comes from ``treegraph.gather_light``, or from a plain NumPy ray caster.
"""

import math

import numpy as np

from species.growth import GrowthSettings, Plant, Site
from treegraph import HalfSpace, Leaves, Light, Occluders, Sky, gather_light, gather_light_exact
from treegraph.obstacles import Ball, Box

MASK = (1 << 64) - 1
DIES, FLUSHES, LEANS, TURNS, BRANCHES, ROLLS = 1, 2, 3, 4, 5, 6
LIVING, DEAD, SPENT = "living", "dead", "spent"
UP = (0.0, 0.0, 1.0)
EXACT_ORDER = (12, 24)  # directions of the plain light


# ---------------------------------------------------------------- chance


def splitmix(z):
    """The finaliser of SplitMix64 after its step."""
    z = (z + 0x9E3779B97F4A7C15) & MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return z ^ (z >> 31)


def key_of_plant(seed, number):
    return splitmix(seed ^ splitmix(number))


def key_of_child(key, bud):
    return splitmix(key ^ ((0xD1B54A32D192ED03 * (bud + 1)) & MASK))


def uniform(key, purpose, bud, year):
    word = (purpose << 48) | (bud << 32) | year
    return (splitmix(key ^ splitmix(word)) >> 11) / 2.0**53


def normal(key, purpose, bud):
    one, two = uniform(key, purpose, bud, 1), uniform(key, purpose, bud, 2)
    return math.sqrt(-2.0 * math.log(1.0 - one)) * math.cos(2.0 * math.pi * two)


# ---------------------------------------------------------------- vectors


def add(a, b):
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def minus(a, b):
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def times(s, a):
    return (s * a[0], s * a[1], s * a[2])


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def unit(a):
    return times(1.0 / math.sqrt(dot(a, a)), a)


def across(side, direction):
    """What of `side` is across `direction`, of length one; some vector across it if that is nothing."""
    rest = minus(side, times(dot(side, direction), direction))
    if dot(rest, rest) < 1e-12:
        x, y, z = direction
        rest = (0.0, z, -y) if abs(x) < 0.6 else (-z, 0.0, x)
    return unit(rest)


def leaned(direction, side, angle, azimuth):
    """`direction`, leaning by `angle` to where `azimuth` points, counted from `side` around it."""
    other = cross(direction, side)
    towards = add(times(math.cos(azimuth), side), times(math.sin(azimuth), other))
    return unit(add(times(math.cos(angle), direction), times(math.sin(angle), towards)))


def turned(v, axis, angle):
    """Rodrigues' rotation."""
    c, s = math.cos(angle), math.sin(angle)
    out = add(times(c, v), times(s, cross(axis, v)))
    return add(out, times(dot(axis, v) * (1.0 - c), axis))


# ---------------------------------------------------------------- obstacles


def runs_into(a, b, obstacle):
    """Whether the way from a to b touches the inside of an obstacle."""
    a, b = np.array(a), np.array(b)
    if isinstance(obstacle, HalfSpace):
        return bool((b - obstacle.point) @ obstacle.normal < 0.0)
    if isinstance(obstacle, Ball):
        length = np.linalg.norm(b - a)
        along = (b - a) / length
        s = min(max((obstacle.center - a) @ along, 0.0), length)
        return bool(np.linalg.norm(a + s * along - obstacle.center) < obstacle.radius)
    assert isinstance(obstacle, Box)
    a, b = ((p - obstacle.center) @ np.asarray(obstacle.rotation) for p in (a, b))
    first, last = 0.0, 1.0  # of the way, what is between each pair of faces
    for x, dx, half in zip(a, b - a, obstacle.size / 2, strict=True):
        if dx == 0.0:
            if abs(x) > half:
                return False
            continue
        ends = sorted([(-half - x) / dx, (half - x) / dx])
        first, last = max(first, ends[0]), min(last, ends[1])
    return first <= last


# ---------------------------------------------------------------- the tree


class Node:
    """A node with the segment below it, and its buds: the apical one, then the lateral ones."""

    def __init__(self, plant, parent, bud, birth, key):
        self.plant, self.parent, self.bud_of, self.birth, self.key = plant, parent, bud, birth, key
        self.order = 0 if parent is None else parent.order + (bud > 0)
        self.children = []
        self.length = self.bend = self.mass = self.spent = 0.0
        self.light = 1.0
        self.position, self.direction, self.side, self.roll = plant.position, UP, (1.0, 0.0, 0.0), 0.0
        self.radius = plant.tip
        self.buds = [LIVING]
        if parent is not None:
            self.light = parent.light
            self.buds += [LIVING] * plant.parameters.n_lateral_buds
            parent.children.append(self)

    def subtree(self):
        """This node and all that hangs on it."""
        out, todo = [], [self]
        while todo:
            node = todo.pop()
            out.append(node)
            todo += node.children
        return out


class Grower:
    """A plant with its parameters by the paper's symbols."""

    def __init__(self, number, plant, settings, seed):
        self.number, self.parameters, self.position = number, plant.parameters, plant.position
        self.planted = plant.planted
        self.base_z = plant.position[2]
        self.tip = settings.tip_share * plant.parameters.internode_length
        for symbol, value in plant.parameters.symbols().items():
            setattr(self, symbol, value)
        self.root = Node(self, None, 0, plant.planted, key_of_plant(seed, number))


class Stand:
    """All plants, all living nodes in the order in which they grew, and the year."""

    def __init__(self, plants, seed, site, settings, light):
        self.settings, self.seed = settings, seed
        self.site = site.occluders or Occluders()
        self.sky = site.sky or Sky()
        self.plants = [Grower(k, plant, settings, seed) for k, plant in enumerate(plants)]
        self.nodes = [plant.root for plant in self.plants]
        self.year = 0
        self.cell = 1.5 * max(plant.IBL for plant in self.plants)
        self.corner = tuple(x - 0.3 * self.cell for x in self.plants[0].position)
        self.look = {"fast": self.fast_light, "exact": self.exact_light}[light]

    def fast_light(self, points, occluders, own):
        return gather_light(points, occluders, self.sky, own=own, rings=self.settings.rings)

    def exact_light(self, points, occluders, own):
        return gather_light_exact(points, occluders, self.sky, own=own, order=EXACT_ORDER)

    def age(self, plant):
        return self.year - plant.planted

    def growing(self):
        return [node for node in self.nodes if self.age(node.plant) >= 0]

    def cycle(self):
        """One year."""
        self.kill_buds()
        vector = self.find_light()
        shoots = self.flush()
        self.extend(shoots, vector)
        self.shed()
        self.thicken()
        self.weigh_and_bend()
        self.drop_bent()
        self.year += 1

    # 1. death

    def kill_buds(self):
        for node in self.growing():
            for k, bud in enumerate(node.buds):
                rate = node.plant.LB_D if k else node.plant.AB_D
                if bud == LIVING and uniform(node.key, DIES, k, self.year) < rate:
                    node.buds[k] = DEAD

    # 2. light

    def is_leafy(self, node, year):
        if node.parent is None:
            return False
        young = node.birth > year - self.settings.leaf_cycles
        return young or (not node.children and node.buds[0] == LIVING)

    def leaf_area(self, node):
        return self.settings.foliage * node.length * node.plant.IBL

    def in_cells(self, nodes, size):
        """The nodes by the cell of a cubic grid that they lie in; cells in the order of their first."""
        cells = {}
        for node in nodes:
            place = tuple(
                math.floor((x - x0) / size) for x, x0 in zip(node.position, self.corner, strict=True)
            )
            cells.setdefault(place, []).append(node)
        return cells

    def find_light(self):
        """Sets the light of the nodes; returns the light's unit vector by node."""
        leafy = [node for node in self.nodes if self.is_leafy(node, self.year - 1)]
        leafy = [node for node in leafy if self.leaf_area(node) > 0.0]
        most = min(self.settings.max_clusters * len(self.plants), 1024)
        while len(cells := self.in_cells(leafy, self.cell)) > most:
            self.cell *= 1.26
        clusters = list(cells.values())
        radius = self.cell * (3.0 / (4.0 * math.pi)) ** (1.0 / 3.0)  # of a ball of the cell's volume
        centers, density = [], []
        for members in clusters:
            areas = np.array([self.leaf_area(node) for node in members])
            centers.append(areas @ np.array([node.position for node in members]) / areas.sum())
            density.append(areas.sum() / self.cell**3)
        density = np.array(density)
        leaves = Leaves(
            np.array([*centers, *self.site.leaves.center]).reshape(-1, 3),
            np.concatenate([np.full(len(centers), radius), self.site.leaves.radius]),
            np.concatenate([0.5 ** (radius * density), self.site.leaves.translucency]),
        )
        number = {node: k for k, members in enumerate(clusters) for node in members}
        looked_at = [
            node
            for node in self.nodes
            if node in number or (self.age(node.plant) >= 0 and LIVING in node.buds)
        ]
        probes = list(self.in_cells(looked_at, self.cell / 2).values())
        points = np.array([np.mean([node.position for node in members], axis=0) for members in probes])
        own = [next((number[node] for node in members if node in number), -1) for members in probes]
        light = Light(np.empty(0), np.empty((0, 3)))
        if probes:
            occluders = Occluders(leaves, self.site.branches, self.site.obstacles)
            light = self.look(points, occluders, np.array(own))
        vector = {}
        for k, (members, cluster) in enumerate(zip(probes, own, strict=True)):
            length = np.linalg.norm(light.vector[k])
            towards = light.vector[k] / length if length > 0.0 else np.zeros(3)
            for node in members:
                vector[node] = tuple(towards)
                node.light = light.amount[k]
                if cluster >= 0:
                    others = sum(self.leaf_area(x) for x in clusters[cluster] if x is not node)
                    if node not in clusters[cluster]:
                        others = sum(self.leaf_area(x) for x in clusters[cluster])
                    node.light *= 0.5 ** (0.5 * radius * others / self.cell**3)
        return vector

    # 3. flushing

    def internodes(self, node, highest):
        plant, t = node.plant, self.age(node.plant)
        control = plant.AC * plant.AC_AF**t
        level = node.order if control > 1.0 else node.order - highest
        try:
            slower = control**level
        except OverflowError:
            return 0
        return math.floor(plant.GR / slower + 0.5)

    def flush(self):
        """The internodes of each new shoot, by node and bud. Eq. 3 with its sum over the buds above."""
        shoots = {}
        above = {node: [] for node in self.nodes}  # ways to the flushing buds above, by node
        for node in reversed(self.nodes):
            plant, t = node.plant, self.age(node.plant)
            if t < 0:
                continue
            n = self.internodes(node, max(x.order for x in plant.root.subtree()))
            strength = plant.AD_BF * plant.AD_AF**t
            may = [n > 0 and bud == LIVING for bud in node.buds]
            chance = node.light**plant.LF_A
            if may[0] and uniform(node.key, FLUSHES, 0, self.year) < chance:
                shoots[node, 0] = n
                above[node].append(0.0)
            auxin = sum(strength * plant.AD_DF**way for way in above[node])
            chance = node.light**plant.LF_L * math.exp(-auxin)
            for k in range(1, len(node.buds)):
                if may[k] and uniform(node.key, FLUSHES, k, self.year) < chance:
                    shoots[node, k] = n
                    above[node].append(0.0)
            if node.parent is not None:
                above[node.parent] += [way + node.length for way in above[node]]
        return shoots

    # 4. shoots

    def bud_direction(self, node, k):
        plant = node.plant
        if k == 0:
            angle = math.radians(math.sqrt(plant.AAV)) * normal(node.key, LEANS, 0)
            azimuth = 2.0 * math.pi * uniform(node.key, TURNS, 0, 0)
        else:
            angle = plant.BAM + math.sqrt(plant.BAV) * normal(node.key, BRANCHES, k)
            angle = math.radians(min(max(angle, 0.0), 180.0))
            azimuth = node.roll + math.radians(360.0 * (k - 1) / plant.NLB)
        return leaned(node.direction, node.side, angle, azimuth)

    def extend(self, shoots, vector):
        for start in list(self.nodes):
            for k in range(len(start.buds)):
                if (start, k) in shoots:
                    start.buds[k] = SPENT
                    self.grow_shoot(start, k, shoots[start, k], vector[start])

    def grow_shoot(self, start, k, n, light):
        plant = start.plant
        direction = self.bud_direction(start, k)
        length = plant.IBL * plant.IL_AF ** self.age(plant)
        pull = add(times(plant.PT, light), times(plant.GT, UP))
        at, bud = start, k
        for _ in range(n):
            wish = add(direction, pull)
            if dot(wish, wish) > 1e-12:
                direction = unit(wish)
            end = add(at.position, times(length, direction))
            if self.is_solid(at.position, end, plant):
                at.buds[bud] = DEAD
                return
            at.buds[bud] = SPENT
            node = Node(plant, at, bud, self.year, key_of_child(at.key, bud))
            node.position, node.direction, node.length = end, direction, length
            node.side = across(at.direction if bud else at.side, direction)
            turn = math.radians(plant.RAM + math.sqrt(plant.RAV) * normal(node.key, ROLLS, 0))
            node.roll = ((0.0 if bud else at.roll) + turn) % (2.0 * math.pi)
            self.nodes.append(node)
            at, bud = node, 0

    def is_solid(self, start, end, plant):
        if self.settings.ground and end[2] < plant.base_z:
            return True
        return any(runs_into(start, end, obstacle) for obstacle in self.site.obstacles)

    # 5. shedding

    def remove(self, fallen):
        """Take marked nodes away with all they carry; their pipes stay if they had been weighed."""
        gone = set()
        for node in self.nodes:
            if node in fallen and node not in gone:
                gone.update(node.subtree())
                node.parent.children.remove(node)
                node.parent.spent += node.pipe if hasattr(node, "pipe") else 0.0
        self.nodes = [node for node in self.nodes if node not in gone]

    def shed(self):
        fallen = []
        for node in self.nodes:
            if node.bud_of == 0:
                continue
            branch = node.subtree()
            light = sum(x.light for x in branch if self.is_leafy(x, self.year) and self.leaf_area(x) > 0.0)
            low = node.parent.position[2] - node.plant.base_z < node.plant.LB_PF
            if low or light < self.settings.shed_unit * node.plant.PF * len(branch):
                fallen.append(node)
        self.remove(set(fallen))

    # 6. radii and masses

    def thicken(self):
        x = self.settings.pipe_exponent
        for node in reversed(self.nodes):
            node.pipe = node.plant.tip**x + node.spent + sum(child.pipe for child in node.children)
            node.radius = node.pipe ** (1.0 / x)

    def own_mass(self, node):
        if node.parent is None:
            return 0.0
        wood = self.settings.wood_density * math.pi * node.radius**2 * node.length
        leafy = not node.children or node.birth > self.year - self.settings.leaf_cycles
        return wood + (self.settings.leaf_density * self.leaf_area(node) if leafy else 0.0)

    # 7. bending

    def weigh_and_bend(self):
        turns = []
        for node in self.nodes:
            carried = [x for x in node.subtree() if x.parent is not None]
            masses = [self.own_mass(x) for x in carried]
            middles = [minus(x.position, times(0.5 * x.length, x.direction)) for x in carried]
            node.mass = sum(masses)
            if node.parent is None:
                continue
            center = times(1.0 / node.mass, np.array(masses) @ np.array(middles))
            foot = node.parent.position
            x, y, z = node.direction
            lever = abs(dot(minus(center, foot), (x, y, 0.0)))
            force = self.settings.bend_unit * node.plant.GBS * node.mass * lever * (1.0 - abs(z))
            limit = math.pi / 2.0 * node.plant.GBA ** (2.0 * node.radius * 100.0)
            if limit > 0.0 and node.plant.GBS > 0.0:
                turns.append((node, max(0.0, limit * (1.0 - math.exp(-force / limit)) - node.bend)))
        for node, angle in turns:
            x, y, z = node.direction
            level = math.hypot(x, y)
            if angle <= 0.0 or level <= 1e-9:
                continue
            angle = min(angle, math.acos(max(-1.0, min(1.0, -z))))
            node.bend += angle
            axis = (-y / level, x / level, 0.0)
            for part in node.subtree():
                part.direction = unit(turned(part.direction, axis, angle))
                part.side = across(turned(part.side, axis, angle), part.direction)
        for node in self.nodes:
            if node.parent is not None:
                node.position = add(node.parent.position, times(node.length, node.direction))

    # 8. what was bent into something

    def drop_bent(self):
        self.remove(
            {
                node
                for node in self.nodes
                if node.parent is not None and self.is_solid(node.parent.position, node.position, node.plant)
            }
        )


def grow_reference(plants, years, rng, *, site=None, settings=None, light="fast"):
    """As ``species.grow_stand``; returns the stand."""
    plants = [plant if isinstance(plant, Plant) else Plant(plant) for plant in plants]
    stand = Stand(plants, int(rng.integers(2**63)), site or Site(), settings or GrowthSettings(), light)
    for _ in range(years):
        stand.cycle()
    return stand


def arrays_of(stand, number):
    """What a plant's TreeGraph has: its nodes in the order of growth."""
    nodes = [node for node in stand.nodes if node.plant.number == number]
    place = {node: i for i, node in enumerate(nodes)}
    last = stand.year - 1
    state = {LIVING: 1, DEAD: 2, SPENT: 0}
    return {
        "parent": np.array([-1 if x.parent is None else place[x.parent] for x in nodes]),
        "position": np.array([x.position for x in nodes]),
        "radius": np.array([x.radius for x in nodes]),
        "birth": np.array([x.birth for x in nodes]),
        "order": np.array([x.order for x in nodes]),
        "bud": np.array([state[x.buds[0]] for x in nodes]),
        "lateral_buds": np.array([x.buds[1:].count(LIVING) for x in nodes]),
        "mass": np.array([x.mass for x in nodes]),
        "light": np.array([x.light for x in nodes]),
        "leaf_area": np.array([stand.leaf_area(x) * stand.is_leafy(x, last) for x in nodes]),
    }
