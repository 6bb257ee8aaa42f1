// Index and ICP of the core.
#pragma once

#include <mutex>
#include <optional>

#include "ek/icp.h"
#include "ek/normals.h"
#include "ek/table.h"
#include "memory.hpp"

namespace EK_NAME(binding) {

class Index {
public:
    // With neighbours (2 or more) also the normals of the points, each computed when a registration needs it; with tiles
    // (1 or more) a table of neighbours. Registrations with either take turns. Support: of how many points each is the mean.
    // Noisy: these counts also in the lines of normals. Seen from: the mean of the unit vectors (N, 2) from these to where they were seen from.
    Index(const Points &points, int64_t neighbours, int64_t tiles = 0, const std::optional<Counts> &support = {},
          const std::optional<Points> &seen_from = {}, bool noisy = false)
    {
        constexpr std::size_t cells_per_point = 16, max_cells = std::size_t{1} << 18; // as in the core's front end
        constexpr std::size_t blocks_per_tile = 6;
        constexpr int64_t max_tiles = (int64_t{1} << 26) / int64_t{blocks_per_tile}; // 2^26 blocks: table.h
        if (tiles < 0 || tiles > max_tiles) {
            throw std::invalid_argument("table: found " + std::to_string(tiles) + " tiles, expected 0 to " +
                                        std::to_string(max_tiles));
        }
        if (support && support->shape(0) != points.shape(0)) {
            throw std::invalid_argument("support: points and their counts differ in number");
        }
        if (seen_from && seen_from->shape(0) != points.shape(0)) {
            throw std::invalid_argument("seen_from: points and their directions differ in number");
        }
        const nb::gil_scoped_release others_may_run;
        const std::size_t room = std::max<std::size_t>(points.shape(0), 1);
        memory_ = Memory("target", [&](ek_arena *arena) {
            const ek_status status = ek_index_init(&index_, arena, room, std::min(cells_per_point * room, max_cells));
            return status != EK_OK || tiles == 0
                       ? status
                       : ek_table_init(&table_, arena, &index_, natural(tiles), blocks_per_tile * natural(tiles));
        }, tiles != 0);
        require(ek_index_build(&index_, start_of(points), points.shape(0)), "target");
        if (neighbours != 0) {
            normals_.resize(2 * room);
            require(ek_normals_defer(&index_, natural(neighbours), normals_.data()), "neighbours");
        }
        if (support) {
            support_.assign(support->data(), support->data() + support->shape(0));
            index_.support = support_.data();
            index_.noisy = noisy;
        }
        if (seen_from) {
            seen_from_.assign(start_of(*seen_from), start_of(*seen_from) + 2 * points.shape(0));
            index_.seen_from = seen_from_.data();
        }
    }

    const ek_index &index() const { return index_; }

    // A lock while a registration may change the table or the normals.
    std::unique_lock<std::mutex> lock() const
    {
        return index_.table || index_.deferred ? std::unique_lock<std::mutex>(mutex_) : std::unique_lock<std::mutex>();
    }

private:
    ek_index index_ = {};
    ek_table table_ = {};
    Memory memory_;
    std::vector<ek_real> normals_, seen_from_;
    std::vector<uint32_t> support_;
    mutable std::mutex mutex_;
};

// Normals (N, 2) of points from their nearest neighbours within a radius.
inline nb::object normals(const Points &points, int64_t neighbours, double radius)
{
    const Index index(points, 0);
    std::vector<ek_real> found(2 * std::max<std::size_t>(points.shape(0), 1));
    {
        const nb::gil_scoped_release others_may_run;
        const auto limit = ek_real(std::min(radius, double(EK_FAR)));
        require(ek_normals_compute(&index.index(), natural(neighbours), limit, found.data()), "neighbours");
    }
    return array_of(std::move(found), {points.shape(0), 2});
}

struct Iteration {
    double error;
    int32_t inliers;
    Row pose;
    std::vector<int64_t> pairs;
};

inline void note(void *context, const ek_icp_iteration *now)
{
    std::vector<int64_t> pairs;
    pairs.reserve(2 * std::size_t(now->inliers));
    for (int32_t i = 0; i < now->inliers; i++) {
        pairs.push_back(now->source[i]);
        pairs.push_back(now->target[i]);
    }
    static_cast<std::vector<Iteration> *>(context)->push_back(
        {double(now->error), now->inliers, row_of(now->target_from_source), std::move(pairs)});
}

class Icp {
public:
    Icp(double epsilon, int64_t max_iterations, int64_t error, bool error_before, bool one_to_one,
        double max_correspondence, int64_t min_pairs, bool lines, double cauchy, bool share_noise)
        : parameters_(ek_icp_default())
    {
        parameters_.epsilon = ek_real(epsilon);
        parameters_.max_iterations = whole(max_iterations);
        parameters_.error = static_cast<ek_error_measure>(std::clamp<int64_t>(error, 0, EK_ERROR_RMSE + 1));
        parameters_.error_before = error_before;
        parameters_.one_to_one = one_to_one;
        parameters_.max_correspondence = ek_real(max_correspondence);
        parameters_.min_pairs = whole(min_pairs);
        parameters_.metric = lines ? EK_METRIC_LINE : EK_METRIC_POINT;
        parameters_.cauchy = ek_real(cauchy);
        parameters_.share_noise = share_noise;
        require(ek_icp_check(&parameters_), "parameters");
    }

    // Origin: where the source was seen from, x y in its frame.
    nb::tuple answer(const Index &target, const Points &source, const Row &guess, bool trace,
                     const std::optional<std::tuple<double, double>> &origin)
    {
        ek_match match;
        std::vector<Iteration> history;
        {
            const nb::gil_scoped_release others_may_run;
            const std::lock_guard<std::mutex> one_at_a_time(mutex_);
            const std::unique_lock<std::mutex> turn = target.lock();
            const auto [x, y] = origin.value_or(std::make_tuple(double(NAN), double(NAN)));
            parameters_.origin_x = ek_real(x);
            parameters_.origin_y = ek_real(y);
            make_room(std::max<std::size_t>(source.shape(0), 1), std::max<std::size_t>(target.index().count, 1));
            require(ek_icp_register(&icp_, &target.index(), start_of(source), source.shape(0), pose_of(guess),
                                    &parameters_, trace ? note : nullptr, &history, &match),
                    "registration");
        }
        nb::list iterations;
        for (Iteration &now : history) {
            const std::size_t pairs = now.pairs.size() / 2;
            iterations.append(
                nb::make_tuple(now.error, now.inliers, now.pose, array_of(std::move(now.pairs), {pairs, 2})));
        }
        return nb::make_tuple(row_of(match.target_from_source), match.converged != 0, match.iterations,
                              double(match.error), match.inliers, iterations);
    }

    const ek_icp_parameters &parameters() const { return parameters_; }

private:
    void make_room(std::size_t sources, std::size_t targets)
    {
        if (sources <= icp_.capacity && targets <= icp_.targets) {
            return;
        }
        ek_icp larger = {};
        memory_ = Memory("registration", [&](ek_arena *arena) {
            const ek_status status =
                ek_icp_init(&larger, arena, std::max(sources, icp_.capacity), std::max(targets, icp_.targets));
            const bool lines = parameters_.metric == EK_METRIC_LINE;
            const ek_status further = status == EK_OK && lines ? ek_icp_init_lines(&larger, arena) : status;
            return further == EK_OK ? ek_icp_init_table(&larger, arena) : further;
        });
        icp_ = larger;
    }

    ek_icp_parameters parameters_;
    ek_icp icp_ = {};
    Memory memory_;
    std::mutex mutex_;
};

} // namespace EK_NAME(binding)
