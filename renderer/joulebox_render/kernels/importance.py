"""Where indirect light comes from, as the photon map knows it: chances of the cells of a hemisphere.

Source: Jensen 1995, "Importance driven path tracing using the photon map". The cells have equal parts of a cosine
distribution, so that without photons every cell has the same chance.
"""

import math

import numpy as np

from joulebox_render.kernels.compilation import device, kernel
from joulebox_render.kernels.kdtree import candidate_row, nearest_points
from joulebox_render.kernels.vector import row3, tangent_frame

# Cells of a hemisphere: rows in sin^2 of the polar angle, columns in azimuth.
CELL_ROWS, CELL_COLUMNS = 4, 8
# What is added to each cell, in photons: few photons tell little of where light comes from.
PRIOR = 2.0
# Share of the rays that goes everywhere alike at least: photons do not know of light too faint for them.
LEAST_EVERYWHERE = 0.3


@kernel
def incoming_chances(tree, wi, flux, history, least_history, points, first, k, reach, cos_limit, scratch, chance):
    """Chance (Q, CELL_ROWS * CELL_COLUMNS) f4 of each cell of the hemispheres over points [first, first + Q).

    wi, flux (P, 3) f4 and history (P,) u1 in the tree's order; photons of a history below `least_history` bring light
    that gather rays do not look for. Chances of a point add up to 1.
    """
    cells = CELL_ROWS * CELL_COLUMNS
    for q in range(chance.shape[0]):
        x, y, z = row3(points.position, first + q)
        nx, ny, nz = row3(points.normal, first + q)
        sx, sy, sz, tx, ty, tz = tangent_frame(nx, ny, nz)
        for cell in range(cells):
            chance[q, cell] = 0.0
        found = nearest_points(tree, x, y, z, nx, ny, nz, cos_limit, reach * reach, k, scratch)
        total, counted = 0.0, 0
        for i in range(found):
            row = candidate_row(scratch.candidates[i])
            dx, dy, dz = row3(wi, row)
            cosine = dx * nx + dy * ny + dz * nz
            if history[row] < least_history or cosine <= 0.0:
                continue
            power = flux[row, 0] + flux[row, 1] + flux[row, 2]
            azimuth = math.atan2(dx * tx + dy * ty + dz * tz, dx * sx + dy * sy + dz * sz) / (2.0 * math.pi)
            across = min(CELL_ROWS - 1, np.int64(max(0.0, 1.0 - cosine * cosine) * CELL_ROWS))
            along = min(CELL_COLUMNS - 1, np.int64((azimuth - math.floor(azimuth)) * CELL_COLUMNS))
            chance[q, across * CELL_COLUMNS + along] += power
            total += power
            counted += 1
        everywhere = max(LEAST_EVERYWHERE, PRIOR * cells / (PRIOR * cells + counted))
        scale = (1.0 - everywhere) / total if total > 0.0 else 0.0
        for cell in range(cells):
            chance[q, cell] = chance[q, cell] * scale + everywhere / cells


@device
def warp_to_cells(chance, q, u, v):
    """Move a uniform (u, v) to where the chances of point q put it: (u, v, weight = uniform density over the new).

    Rows first, then columns within the row, so that samples stratified in the unit square stay so.
    """
    below, row, share = 0.0, 0, 0.0
    while True:
        share = 0.0
        for column in range(CELL_COLUMNS):
            share += chance[q, row * CELL_COLUMNS + column]
        if u < below + share or row == CELL_ROWS - 1:
            break
        below += share
        row += 1
    inside = min(max(0.0, (u - below) / share), 0.9999999)
    v *= share
    below, column = 0.0, 0
    while v >= below + chance[q, row * CELL_COLUMNS + column] and column < CELL_COLUMNS - 1:
        below += chance[q, row * CELL_COLUMNS + column]
        column += 1
    cell = chance[q, row * CELL_COLUMNS + column]
    along = min(max(0.0, (v - below) / cell), 0.9999999)
    weight = 1.0 / (CELL_ROWS * CELL_COLUMNS * cell)
    return (row + inside) / CELL_ROWS, (column + along) / CELL_COLUMNS, weight
