"""Cable nets without a membrane: a saddle of 286 links, and a prestressed net of 12 cables.

The saddle is the example `saddle.py` of jorgepz/cablenets, which minimises the energy of links that
take no compression as a conic programme with CVXOPT. Its output is not published: geometry, data
and loads were read in the example, and the positions are compared with a convex programme of our
own, solved by scipy, which has one minimum only. The prestressed net is example 7-003 of SAP2000's
verification manual, whose independent results are of A. G. Tibert's thesis (1999), table 4.4; it
goes back to S. A. Saafan. The manual's page was read in a public copy.

    ./run python benchmarks/validation/cable_nets.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

sys.path.insert(0, str(Path(__file__).parents[1]))
from crms_fenicsx import Bar, IsotropicMembrane, Joint, Scene, Solver, meshes
from validation.table import COMM, OURS, PUBLISHED, Row, labels, panels, report, save

EDGE, NODES, YOUNG, DIAMETER, HEIGHT = 2.0, 12, 200.0, 0.01, 1.0
"""Saddle: edge (m), nodes of an edge, modulus (GN/m2), diameter of a link, raised corners (m)."""
DENSITY = 785000 * 9.81 / 1e9
AREA = np.pi * DIAMETER**2 / 4
BAY, DEPTH, SECTION, MODULUS = 100.0, 30.0, 0.227, 12000.0
"""Prestressed net: bay, rise (ft), section (square inches), modulus (kips per square inch)."""
HORIZONTAL, INCLINED, LOAD, SELF_WEIGHT = 5.459, 5.325, 8.0, 1e-4
"""Prestressing forces, load on each crossing (kips), weight (kips/ft)."""
SIDE_VIEW = np.array([(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0)])
"""Turns positions into x - y and z."""
TIBERT, SAP2000 = (-0.1328, -0.1328, -1.4764), (-0.1328, -0.1328, -1.4745)
"""Displacements of the crossings (ft)."""


def empty_scene() -> Scene:
    """A scene needs a membrane: a small held triangle far from all."""
    points = [(90.0, 90.0), (91.0, 90.0), (90.0, 91.0)]
    mesh = meshes.from_arrays(COMM, points, [(0, 1, 2)], point_groups={"corners": [0, 1, 2]})
    scene = Scene(mesh, IsotropicMembrane(1.0, 0.3, 1.0))
    scene.fix("corners")
    return scene


def saddle() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Nodes at the start, links, unstressed lengths and loads of the saddle.

    A square grid; both diagonals of each cell and the edges of the square are links.
    """
    x = np.linspace(0.0, EDGE, NODES)
    nodes = np.array([(a, b, 0.0) for b in x for a in x])
    n = np.arange(NODES**2).reshape(NODES, NODES)
    diagonals = [np.column_stack([n[:-1, :-1].ravel(), n[1:, 1:].ravel()]),
                 np.column_stack([n[:-1, 1:].ravel(), n[1:, :-1].ravel()])]  # fmt: skip
    rims = [np.column_stack([row[:-1], row[1:]]) for row in (n[0], n[-1], n[:, 0], n[:, -1])]
    links = np.vstack(diagonals + rims)
    lengths = np.linalg.norm(nodes[links[:, 0]] - nodes[links[:, 1]], axis=1)
    weight = DENSITY * AREA * EDGE * np.sqrt(2) / (2 * (NODES - 1)) / 2
    return nodes, links, lengths, np.tile([0.0, 0.0, -weight], (len(nodes), 1))


def corners(nodes: np.ndarray) -> dict[int, np.ndarray]:
    """Where the four held corners are: two opposite ones are raised."""
    last = NODES - 1
    held = {0: HEIGHT, last: 0.0, last * NODES: 0.0, NODES**2 - 1: HEIGHT}
    return {k: nodes[k] + (0.0, 0.0, z) for k, z in held.items()}


def saddle_by_bars() -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) of the saddle's nodes and forces of its links by the package."""
    nodes, links, lengths, loads = saddle()
    held = corners(nodes)
    rise = HEIGHT * np.abs(nodes[:, 0] + nodes[:, 1] - EDGE) / EDGE
    scene = empty_scene()
    ends: list[Joint | tuple[float, ...]] = [
        tuple(held[k]) if k in held else scene.add_joint((x, y, z))
        for k, ((x, y, _), z) in enumerate(zip(nodes, rise, strict=True))
    ]
    EA = YOUNG * AREA
    bars = [scene.add_bar(Bar(EA, tension_only=True), ends[a], ends[b], L0=float(L))
            for (a, b), L in zip(links, lengths, strict=True)]  # fmt: skip
    joints = {end: tuple(map(float, load)) for end, load in zip(ends, loads, strict=True)
              if isinstance(end, Joint)}  # fmt: skip
    scene.put_joint_load(joints, name="weight")
    Solver(scene).advance(load=1.0)
    found = np.array([end.position if isinstance(end, Joint) else end for end in ends])
    return found, np.array([bar.force for bar in bars])


def saddle_by_programme() -> tuple[np.ndarray, np.ndarray]:
    """The same by a convex programme: the energy of links that take no compression."""
    nodes, links, lengths, loads = saddle()
    held = corners(nodes)
    EA = YOUNG * AREA
    start = nodes.copy()
    start[:, 2] = HEIGHT * np.abs(nodes[:, 0] + nodes[:, 1] - EDGE) / EDGE
    for k, place in held.items():
        start[k] = place
    free = np.setdiff1d(np.arange(len(nodes)), list(held))

    def energy(q: np.ndarray) -> tuple[float, np.ndarray]:
        x = start.copy()
        x[free] = q.reshape(-1, 3)
        way = x[links[:, 1]] - x[links[:, 0]]
        long = np.linalg.norm(way, axis=1)
        stretch = np.maximum(long - lengths, 0.0)
        force = EA * stretch / lengths
        slope = np.zeros_like(x)
        pull = (force / long)[:, None] * way
        np.add.at(slope, links[:, 0], -pull)
        np.add.at(slope, links[:, 1], pull)
        scale = 1e6
        value = float(np.sum(EA * stretch**2 / lengths / 2) - np.sum(loads * x))
        return scale * value, scale * (slope - loads)[free].ravel()

    q = start[free].ravel()
    for _ in range(4):
        q = minimize(energy, q, jac=True, method="L-BFGS-B",
                     options={"maxiter": 20000, "maxfun": 40000, "ftol": 1e-16, "gtol": 1e-9,
                              "maxcor": 60}).x  # fmt: skip
    x = start.copy()
    x[free] = q.reshape(-1, 3)
    long = np.linalg.norm(x[links[:, 1]] - x[links[:, 0]], axis=1)
    return x, EA * np.maximum(long - lengths, 0.0) / lengths


def prestressed_net() -> tuple[float, float, float]:
    """Displacement of a crossing of the prestressed net.

    Four cables in two directions, 3 bays long; their crossings lie at (+-50, +-50, -30) before.
    Each cable is a horizontal link between two inclined ones. Links carry half of their weight at
    each end; their unstressed length is that at which the given shape has the given forces.
    """
    scene = empty_scene()
    EA = SECTION * MODULUS
    half = BAY / 2
    places = {(a, b): (a * half, b * half, -DEPTH) for a in (-1, 1) for b in (-1, 1)}
    joints = {key: scene.add_joint(place) for key, place in places.items()}

    def link(a: Joint | tuple[float, ...], b: Joint, ends: np.ndarray, force: float) -> None:
        long = float(np.linalg.norm(ends[1] - ends[0]))
        scene.add_bar(Bar(EA), a, b, L0=long / (1 + force / EA))

    weights = dict.fromkeys(joints, 0.0)
    for (a, b), joint in joints.items():
        place = np.array(places[a, b])
        for anchor in ((3 * a * half, b * half, 0.0), (a * half, 3 * b * half, 0.0)):
            link(anchor, joint, np.array([anchor, place]), INCLINED)
            weights[a, b] += SELF_WEIGHT * float(np.linalg.norm(place - anchor)) / 2
        weights[a, b] += SELF_WEIGHT * BAY
    for one in ((-1, -1), (-1, 1), (1, 1), (1, -1)):
        other = (one[1], -one[0])  # the next one around
        link(joints[one], joints[other], np.array([places[one], places[other]]), HORIZONTAL)
    scene.put_joint_load({joint: (0.0, 0.0, -LOAD - weights[key]) for key, joint in joints.items()},
                         name="load")  # fmt: skip
    Solver(scene).advance(load=1.0)
    moved = np.array(joints[-1, -1].position) - places[-1, -1]
    return float(moved[0]), float(moved[1]), float(moved[2])


def main() -> None:
    """Print the table and draw the picture."""
    ours, forces = saddle_by_bars()
    theirs, others = saddle_by_programme()
    k = int(np.argmax(others))
    middle, off = NODES // 2 * NODES + NODES // 2, np.abs(forces - others).max() / others.max()
    rows = [
        Row("saddle: largest force of a link (kN)", 1e6 * float(others[k]), 1e6 * float(forces[k]),
            0.0, f"own convex programme; all forces within {off:.0e} of it"),
        Row("saddle: height of a node at the middle (m)", float(theirs[middle, 2]),
            float(ours[middle, 2]), 0.0, "own convex programme; all nodes within "
            f"{np.abs(ours - theirs).max():.0e} m"),
    ]  # fmt: skip
    moved = prestressed_net()
    for axis, a, b, c in zip("xyz", TIBERT, SAP2000, moved, strict=True):
        rows.append(Row(f"prestressed net: u_{axis} of the crossings (ft)", a, c, 0.0,
                        "second hand: Tibert 1999, catenaries, in SAP2000's manual"))  # fmt: skip
        rows.append(Row(f"prestressed net: u_{axis} of the crossings (ft)", b, c, 0.0,
                        "first hand: SAP2000's manual, example 7-003"))  # fmt: skip
    report("cable nets", rows)
    figure, (left, right) = panels()
    _, links, _, _ = saddle()
    tight = forces / forces.max()
    for (a, b), force in zip(links, tight, strict=True):
        if force > 1e-6:
            left.plot(*(ours[[a, b]] @ SIDE_VIEW).T, color=OURS,
                      linewidth=0.4 + 1.6 * force)  # fmt: skip
    labels(left, "x - y [m]", "z [m]", "saddle without its slack links", legend=False)
    right.plot(1e6 * others, 1e6 * forces, ".", color=OURS, markersize=4)
    right.plot([0, 1e6 * others.max()], [0, 1e6 * others.max()], color=PUBLISHED, linewidth=0.8)
    labels(right, "force by the convex programme [kN]", "force by the package [kN]",
           "saddle, 286 links", legend=False)  # fmt: skip
    save(figure, "cable_nets")


if __name__ == "__main__":
    main()
