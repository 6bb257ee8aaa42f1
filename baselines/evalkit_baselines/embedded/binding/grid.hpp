// Growable map on top of the core's fixed one.
#pragma once

#include <mutex>

#include "ek/grid.h"
#include "memory.hpp"

namespace EK_NAME(binding) {

using Extent = std::tuple<int64_t, int64_t, int64_t, int64_t>; // left, bottom, columns, rows

class Grid {
public:
    Grid(double resolution, double l_occ, double l_free, double l_min, double l_max, double range_max,
         const Extent &extent, bool polygon, double widest_gap)
    {
        ek_grid_parameters parameters = ek_grid_default();
        parameters.resolution = ek_real(resolution);
        parameters.l_occ = ek_real(l_occ);
        parameters.l_free = ek_real(l_free);
        parameters.l_min = ek_real(l_min);
        parameters.l_max = ek_real(l_max);
        parameters.polygon = polygon;
        parameters.widest_gap = ek_real(widest_gap);
        init(parameters, extent, range_max);
    }

    void add(const Row &world_from_sensor, const Points &hits, const Points &misses)
    {
        const nb::gil_scoped_release others_may_run;
        const std::lock_guard<std::mutex> one_at_a_time(mutex_);
        require(ek_grid_add_scan(&grid_, pose_of(world_from_sensor), 0, 0, start_of(hits), hits.shape(0),
                                 start_of(misses), misses.shape(0)),
                "scan");
    }

    // Change extent or longest beam; cells inside both extents keep their values.
    void move(const Extent &extent, double range_max)
    {
        const nb::gil_scoped_release others_may_run;
        const std::lock_guard<std::mutex> one_at_a_time(mutex_);
        const ek_grid old = grid_;
        const Memory kept = init(old.parameters, extent, range_max);
        const int64_t left = std::max(old.left, grid_.left), bottom = std::max(old.bottom, grid_.bottom);
        const int64_t right = std::min(right_of(old), right_of(grid_)), top = std::min(top_of(old), top_of(grid_));
        for (int64_t row = bottom; row < top && left < right; row++) {
            std::copy_n(cell(old, left, row), right - left, cell(grid_, left, row));
        }
    }

    nb::object cells()
    {
        const std::lock_guard<std::mutex> one_at_a_time(mutex_);
        const std::size_t rows = grid_.parameters.rows, columns = grid_.parameters.columns;
        return array_of(std::vector<int16_t>(grid_.cells, grid_.cells + rows * columns), {rows, columns});
    }

    uint32_t touched() const { return grid_.touched_cells; }

    uint32_t ignored_beams() const { return grid_.ignored_beams; }

private:
    static int64_t right_of(const ek_grid &grid) { return int64_t(grid.left) + grid.parameters.columns; }

    static int64_t top_of(const ek_grid &grid) { return int64_t(grid.bottom) + grid.parameters.rows; }

    static int16_t *cell(const ek_grid &grid, int64_t column, int64_t row)
    {
        return grid.cells + (row - grid.bottom) * int64_t(grid.parameters.columns) + (column - grid.left);
    }

    // Create the map again and return the memory of the old one; nothing changes if the core refuses.
    Memory init(ek_grid_parameters parameters, const Extent &extent, double range_max)
    {
        parameters.range_max = ek_real(range_max);
        parameters.left = whole(std::get<0>(extent));
        parameters.bottom = whole(std::get<1>(extent));
        parameters.columns = natural(std::get<2>(extent));
        parameters.rows = natural(std::get<3>(extent));
        ek_grid made = {};
        Memory memory("map", [&](ek_arena *arena) { return ek_grid_init(&made, arena, &parameters); });
        grid_ = made;
        return std::exchange(memory_, std::move(memory));
    }

    ek_grid grid_ = {};
    Memory memory_;
    std::mutex mutex_;
};

} // namespace EK_NAME(binding)
