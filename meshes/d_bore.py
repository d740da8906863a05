"""Write ``d_bore.stl``: a round tube whose bore is flat below, in mm.

The outer wall is a cylinder. The bore is a circle that a flat cuts off below, with corners rounded
by arcs that touch both. The tube lies along z, and stands on the floor under its flat.
"""

from pathlib import Path

import numpy as np
import trimesh

OUTER_DIAMETER = 11.1
BORE_RADIUS = 3.95
FLAT = -2.2  # height of the flat, from the middle of the tube
CORNER_RADIUS = 1.2
LENGTH = 160.0
AROUND, ALONG = 120, 6  # facets around the walls, and along them


def half_bore(n):
    """Return n + 1 points (x, y), evenly spaced along the bore from the flat's middle to its top.

    A corner's arc touches the flat from above and the circle from inside, which puts its centre at
    a known height and a known distance from the middle.
    """
    y = FLAT + CORNER_RADIUS
    x = np.sqrt((BORE_RADIUS - CORNER_RADIUS) ** 2 - y**2)
    meeting = np.arctan2(y, x)  # direction in which both arcs end
    pieces = np.array(
        [x, CORNER_RADIUS * (meeting + np.pi / 2), BORE_RADIUS * (np.pi / 2 - meeting)]
    )
    borders = np.concatenate([[0.0], np.cumsum(pieces)])
    s = np.linspace(0.0, borders[-1], n + 1)
    corner = -np.pi / 2 + (s - borders[1]) / CORNER_RADIUS
    circle = meeting + (s - borders[2]) / BORE_RADIUS
    on = [s < borders[1], s < borders[2]]
    return np.stack(
        [
            np.select(on, [s, x + CORNER_RADIUS * np.cos(corner)], BORE_RADIUS * np.cos(circle)),
            np.select(on, [FLAT, y + CORNER_RADIUS * np.sin(corner)], BORE_RADIUS * np.sin(circle)),
        ],
        axis=-1,
    )


def closed(half):
    """Return a section's outline, counter-clockwise from below, from its half x >= 0."""
    half[[0, -1], 0] = 0.0
    return np.concatenate([half, half[-2:0:-1] * [-1, 1]])


def d_bore():
    """Return the tube as a closed surface in mm."""
    turn = np.linspace(-np.pi / 2, np.pi / 2, AROUND // 2 + 1)
    outer = closed(OUTER_DIAMETER / 2 * np.stack([np.cos(turn), np.sin(turn)], axis=-1))
    inner = closed(half_bore(AROUND // 2))
    z = np.linspace(-LENGTH / 2, LENGTH / 2, ALONG + 1)
    # A closed strip in the (z, radius) plane: along the outer wall, and back along the bore.
    sections = [(outer, height) for height in z] + [(inner, height) for height in z[::-1]]
    points = [np.column_stack([outline, np.full(AROUND, height)]) for outline, height in sections]
    number = np.arange(len(sections) * AROUND).reshape(-1, AROUND)
    a, b = number, np.roll(number, -1, axis=1)
    c, d = np.roll(a, -1, axis=0), np.roll(b, -1, axis=0)
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, d), (a, d, c))])
    return trimesh.Trimesh(np.concatenate(points), faces, process=False)


if __name__ == "__main__":
    d_bore().export(Path(__file__).with_name("d_bore.stl"))
