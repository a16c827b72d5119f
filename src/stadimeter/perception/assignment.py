"""Assignment: which detection belongs to which target, so that all of them together fit best.

Each target by itself would take the detection that fits it best, and two would take the same one. Of all ways to share
them out the one of least total cost is found by shortest augmenting paths (H. W. Kuhn, "The Hungarian method for the
assignment problem", 1955; R. Jonker and A. Volgenant, "A shortest augmenting path algorithm", 1987).
"""

from __future__ import annotations

import math
from collections.abc import Sequence


def assign(costs: Sequence[Sequence[float]], unassigned: float) -> list[int | None]:
    """Return for each row the column that it gets, or None; no column twice, and the total cost is the least.

    Args:
        costs: For each row the cost of each column; infinite for what must not be.
        unassigned: The cost of a row without a column.
    """
    # Each row's best is a bound that no assignment can beat, so it is the answer unless two rows want the same column.
    best = [min(range(len(row)), key=row.__getitem__, default=None) for row in costs]
    best = [None if j is None or row[j] >= unassigned else j for j, row in zip(best, costs, strict=True)]
    taken = [j for j in best if j is not None]
    if len(set(taken)) == len(taken):
        return best
    columns = len(costs[0])
    # A column more for each row stands for "unassigned".
    padded = [[*row, *[unassigned] * len(costs)] for row in costs]
    row_of = _shortest_paths(padded)
    column_of = {row: j for j, row in enumerate(row_of) if row is not None and j < columns}
    return [column_of.get(row) for row in range(len(costs))]


def _shortest_paths(costs: Sequence[Sequence[float]]) -> list[int | None]:
    """Return for each column the row that it is given to; every row gets one, and there are enough of finite cost."""
    columns = range(len(costs[0]))
    row_of: list[int | None] = [None] * len(columns)
    # Prices: no cost less its row's and its column's price is below zero, and those of the pairs that are made are
    # zero. So the cheapest change is a shortest path, and stays so after the prices have been raised along it.
    row_price, column_price = [0.0] * len(costs), [0.0] * len(columns)
    for start in range(len(costs)):
        # Dijkstra's search from the new row to a free column, by way of columns whose rows would have to move on.
        reach, via = [math.inf] * len(columns), [-1] * len(columns)
        done: list[int] = []
        row, so_far, column = start, 0.0, -1
        while True:
            for j in columns:
                length = so_far + costs[row][j] - row_price[row] - column_price[j]
                if j not in done and length < reach[j]:
                    reach[j], via[j] = length, column
            column = min((j for j in columns if j not in done), key=reach.__getitem__)
            so_far = reach[column]
            holder = row_of[column]
            if holder is None:
                break
            done.append(column)
            row = holder
        row_price[start] += so_far
        for j in done:
            column_price[j] -= so_far - reach[j]
            row_price[row_of[j] or 0] += so_far - reach[j]
        # Along the path each row moves on to the next column, from the free one back to the new row.
        while column != -1:
            before = via[column]
            row_of[column] = start if before == -1 else row_of[before]
            column = before
    return row_of
