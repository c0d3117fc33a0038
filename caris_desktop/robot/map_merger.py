"""Map assembly from whole maps and partial updates."""

from dataclasses import replace

import numpy as np

from caris_desktop.domain.sensing import OccupancyGrid
from caris_desktop.ros.message_fields import MessageError
from caris_desktop.ros.navigation_messages import GridUpdate

# A map of 4000 x 4000 cells goes to the window at most a few times a minute, a small one five times a second.
_LEAST_PERIOD_S = 0.2
_CELLS_PER_S = 8_000_000


class MapMerger:
    """Holds the newest whole map and applies updates."""

    def __init__(self) -> None:
        self._grid: OccupancyGrid | None = None

    @property
    def period_s(self) -> float:
        """Minimum interval for passing on the whole map during updates."""
        cells = 0 if self._grid is None else self._grid.cells.size
        return max(_LEAST_PERIOD_S, cells / _CELLS_PER_S)

    def replace(self, grid: OccupancyGrid) -> None:
        """Set a whole map."""
        self._grid = replace(grid, cells=grid.cells.copy())

    def forget(self) -> None:
        self._grid = None

    def update(self, update: GridUpdate, *, stamp_ns: int) -> bool:
        """Apply a partial update. False if there is no map.

        Raises
        ------
        MessageError
            When the part does not lie within the map.
        """
        grid = self._grid
        if grid is None:
            return False
        height, width = update.cells.shape
        rows, columns = grid.cells.shape
        if update.x + width > columns or update.y + height > rows:
            raise MessageError(
                f"an update of {width} x {height} cells at ({update.x}, {update.y}) is outside the map of "
                f"{columns} x {rows}"
            )
        grid.cells[update.y : update.y + height, update.x : update.x + width] = update.cells
        self._grid = replace(grid, stamp_ns=stamp_ns, robot_stamp_ns=update.robot_stamp_ns)
        return True

    def snapshot(self) -> OccupancyGrid | None:
        """Copy of the present map; later updates do not change it."""
        return None if self._grid is None else replace(self._grid, cells=np.array(self._grid.cells))
