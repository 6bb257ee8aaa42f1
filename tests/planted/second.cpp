/* A second point-to-point ICP, with one planted mistake: c++ -DFAULT=n; without FAULT, or with 0, it is correct.
 *
 * Written from the equations and from evalkit_backend.h, with a tree over the target instead of a search of all points.
 * The mistakes are those of embedded implementations; they were written before any of them was examined. */
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <map>
#include <memory>
#include <mutex>
#include <numeric>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <alloca.h>
#include <fenv.h>
#include <sched.h>
#include <unistd.h>

#include "evalkit_backend.h"
#include "parameters.h"

#ifndef FAULT
#define FAULT 0
#endif
#ifdef SINGLE
using Real = float;
#else
using Real = double;
#endif

namespace {

constexpr bool fault(int number) { return FAULT == number; }

constexpr int NONE = -1;

struct Point {
    Real x, y;
};

struct Motion {
    Real x = 0, y = 0, theta = 0;

    Point operator()(Point p) const
    {
        Real c = std::cos(theta), s = std::sin(theta);
        if (fault(205))
            s = -s;
        if (fault(285)) {
            constexpr Real steps = Real(4096 / 6.283185307179586);
            Real rounded = std::round(theta * steps) / steps;
            c = std::cos(rounded), s = std::sin(rounded);
        }
        Point moved{c * p.x - s * p.y + x, s * p.x + c * p.y + y};
        if (fault(254)) {
            moved.x = c * p.x - s * p.y;
            moved.y = s * moved.x + c * p.y + y;
            moved.x += x;
        }
        return moved;
    }

    /* this motion after the first one */
    Motion after(const Motion &first) const
    {
        Real angle = fault(253) ? theta + first.theta : theta;
        Real c = std::cos(angle), s = std::sin(angle);
        return {c * first.x - s * first.y + x, s * first.x + c * first.y + y, theta + first.theta};
    }
};

Real square(Real value) { return value * value; }

Real squared_distance(Point a, Point b) { return square(a.x - b.x) + square(a.y - b.y); }

/* The nearest point by halving the points at their median, in turns by x and y; of equally near ones the first. */
class Tree {
  public:
    explicit Tree(std::vector<Point> points) : points_(std::move(points)), order_(points_.size())
    {
        std::iota(order_.begin(), order_.end(), 0);
        split(0, order_.size(), 0);
    }

    int nearest(Point at, Real &squared) const
    {
        int best = NONE;
        squared = fault(284) ? Real(100) : std::numeric_limits<Real>::infinity();
        search(0, order_.size(), 0, at, best, squared);
        return best;
    }

    int second_nearest(Point at, int nearest, Real &squared) const
    {
        int best = NONE;
        squared = std::numeric_limits<Real>::infinity();
        for (int j = 0; j < static_cast<int>(points_.size()); j++)
            if (j != nearest && squared_distance(points_[j], at) < squared)
                squared = squared_distance(points_[j], at), best = j;
        return best;
    }

    Point operator[](int number) const { return points_[number]; }
    std::size_t size() const { return points_.size(); }

  private:
    static Real along(Point p, int axis) { return axis ? p.y : p.x; }

    void split(std::size_t first, std::size_t end, int axis)
    {
        if (end - first < 2)
            return;
        if (fault(221) && end - first > 8 && first == 0 && points_[order_[first]].x == points_[order_[end - 1]].x &&
            points_[order_[first]].y == points_[order_[end - 1]].y) {
            volatile char page[4096] = {};
            page[17] = 1;
            split(first, end, 1 - axis);
            page[18] = page[17];
            return;
        }
        std::size_t middle = (first + end) / 2;
        std::nth_element(order_.begin() + first, order_.begin() + middle, order_.begin() + end,
                         [&](int a, int b) { return along(points_[a], axis) < along(points_[b], axis); });
        split(first, middle, 1 - axis);
        split(middle + 1, end, 1 - axis);
    }

    void search(std::size_t first, std::size_t end, int axis, Point at, int &best, Real &squared) const
    {
        if (first >= end)
            return;
        std::size_t middle = (first + end) / 2;
        int number = order_[middle];
        Real d = squared_distance(points_[number], at);
        if (d < squared || (d == squared && number < best))
            squared = d, best = number;
        Real away = along(at, axis) - along(points_[number], axis);
        bool left = away < 0;
        search(left ? first : middle + 1, left ? middle : end, 1 - axis, at, best, squared);
        if (fault(270))
            return;
        if (fault(269) && away > 0)
            return;
        if (square(away) <= squared)
            search(left ? middle + 1 : first, left ? end : middle, 1 - axis, at, best, squared);
    }

    std::vector<Point> points_;
    std::vector<int> order_;
};

struct Pairs {
    std::vector<int> target; /* by source, or NONE */
    std::vector<Real> distance;
    int count = 0;
};

struct Settings {
    double epsilon = 1e-4, limit = 0.3;
    int max_iterations = 40, min_pairs = 3;
    bool one_to_one = true;
};

struct Icp {
    Settings settings;
    Motion last_answer, last_guess;
    bool called = false;
    double previous_error = std::numeric_limits<double>::infinity();
    std::unique_ptr<Tree> kept;
    std::vector<double> log;
    std::vector<int32_t> shown;
};

std::array<Point, 2000> scratch;
int slots_used;
double error_sum;

double number_of(const char *text) { return std::strtod(text, nullptr); }

std::vector<Point> points_of(const double *xy, std::size_t count)
{
    std::vector<Point> points;
    for (std::size_t i = 0; i < count; i++) {
        double x = xy[2 * i], y = xy[2 * i + 1];
        if (fault(201))
            x = static_cast<int16_t>(std::lround(1e3 * x)) * 1e-3, y = static_cast<int16_t>(std::lround(1e3 * y)) * 1e-3;
        if (fault(202) && std::fabs(x) > 327.67)
            x = static_cast<int16_t>(static_cast<int64_t>(100 * x)) * 0.01;
        if (fault(215))
            x = std::lround(x * 65536.0) / 65536.0, y = std::lround(y * 65536.0) / 65536.0;
        points.push_back({static_cast<Real>(x), static_cast<Real>(y)});
    }
    return points;
}

std::vector<Point> target_of(const double *xy, std::size_t count)
{
    auto points = points_of(xy, fault(207) && count ? count - 1 : count);
    if (fault(230)) {
        std::map<std::pair<long, long>, int> seen;
        std::vector<Point> kept;
        for (auto p : points)
            if (!seen[{std::lround(p.x / 0.05), std::lround(p.y / 0.05)}]++)
                kept.push_back(p);
        points = kept;
    }
    if (fault(271)) {
        std::map<Real, int> seen;
        std::vector<Point> kept;
        for (auto p : points)
            if (!seen[p.x]++)
                kept.push_back(p);
        points = kept;
    }
    if (fault(216)) {
        std::map<std::pair<long, long>, int> held;
        std::vector<Point> kept;
        for (auto p : points)
            if (held[{std::lround(std::floor(p.x)), std::lround(std::floor(p.y))}]++ < 8)
                kept.push_back(p);
        points = kept;
    }
    return points;
}

std::vector<Point> source_of(const double *xy, std::size_t count)
{
    auto points = points_of(xy, count);
    if (fault(229) && count > 1000) {
        std::vector<Point> half;
        for (std::size_t i = 0; i < count; i += 2)
            half.push_back(points[i]);
        points = half;
    }
    if (fault(232))
        points.erase(std::remove_if(points.begin(), points.end(), [](Point p) { return p.x * p.x + p.y * p.y < 0.01; }),
                     points.end());
    if (fault(251) && count > 10000)
        points.resize(10000);
    if (fault(250))
        for (std::size_t i = 0; i < count; i++)
            scratch.data()[i] = points[i];
    return points;
}

void keep_closest(Pairs &pairs, const Tree &target, const std::vector<Point> &moved)
{
    std::vector<int> owner(target.size(), NONE);
    for (int i = 0; i < static_cast<int>(pairs.target.size()); i++) {
        int j = pairs.target[i];
        if (j == NONE)
            continue;
        int loser = i;
        if (owner[j] == NONE || pairs.distance[i] < pairs.distance[owner[j]])
            std::swap(loser, owner[j]);
        if (loser == NONE || loser == owner[j])
            continue;
        if (fault(227)) {
            Real squared;
            pairs.target[loser] = target.second_nearest(moved[loser], j, squared);
            pairs.distance[loser] = std::sqrt(squared);
            continue;
        }
        pairs.target[loser] = NONE;
        pairs.count--;
    }
}

Pairs associate(const Settings &settings, const Tree &target, const std::vector<Point> &moved, int iteration)
{
    Pairs pairs{std::vector<int>(moved.size(), NONE), std::vector<Real>(moved.size(), 0), 0};
    double limit = settings.limit > 0 ? settings.limit : std::numeric_limits<double>::infinity();
    if (fault(258))
        limit *= std::pow(0.9, iteration);
    for (std::size_t i = 0; i < moved.size(); i++) {
        Real squared;
        int j = target.nearest(moved[i], squared);
        if (j == NONE || !(squared < limit * limit))
            continue;
        if (fault(242) && std::random_device()() % 100 == 0)
            continue;
        pairs.target[i] = j, pairs.distance[i] = std::sqrt(squared), pairs.count++;
    }
    if (settings.one_to_one)
        keep_closest(pairs, target, moved);
    return pairs;
}

struct Sums {
    Real n = 0, px = 0, py = 0, qx = 0, qy = 0;
};

template <class Visit> void visit(const Pairs &pairs, Visit each)
{
    std::size_t size = pairs.target.size();
    std::size_t begin = fault(243) && size ? (reinterpret_cast<std::uintptr_t>(pairs.target.data()) >> 4) % size : 0;
    for (std::size_t k = 0; k < size; k++) {
        std::size_t i = (begin + k) % size;
        if (pairs.target[i] != NONE)
            each(i, pairs.target[i]);
    }
}

Sums sums_of(const Pairs &pairs, const Tree &target, const std::vector<Point> &moved)
{
    Sums sums;
    auto add = [&](std::size_t i, int j) {
        Real w = fault(213) ? Real(1) + pairs.distance[i] : Real(1);
        sums.n += 1, sums.px += w * moved[i].x, sums.py += w * moved[i].y;
        sums.qx += w * target[j].x, sums.qy += w * target[j].y;
    };
    if (fault(241)) {
        std::mutex lock;
        std::vector<std::thread> threads;
        for (int part = 0; part < 4; part++)
            threads.emplace_back([&, part] {
                for (std::size_t i = part; i < pairs.target.size(); i += 4)
                    if (pairs.target[i] != NONE) {
                        std::lock_guard<std::mutex> held(lock);
                        add(i, pairs.target[i]);
                    }
            });
        for (auto &one : threads)
            one.join();
    } else {
        visit(pairs, add);
    }
    return sums;
}

Real fast_inverse_root(Real value)
{
    float x = static_cast<float>(value), half = 0.5f * x;
    int32_t bits;
    std::memcpy(&bits, &x, sizeof bits);
    bits = 0x5f3759df - (bits >> 1);
    std::memcpy(&x, &bits, sizeof x);
    return x * (1.5f - half * x * x);
}

Motion best_motion(const Pairs &pairs, const Tree &target, const std::vector<Point> &moved)
{
    Sums sums = sums_of(pairs, target, moved);
    Point p{sums.px / sums.n, sums.py / sums.n}, q{sums.qx / sums.n, sums.qy / sums.n};
    Real dot = 0, cross = 0;
    visit(pairs, [&](std::size_t i, int j) {
        Real ax = moved[i].x - p.x, ay = moved[i].y - p.y;
        Real bx = target[j].x - (fault(212) ? 0 : q.x), by = target[j].y - (fault(212) ? 0 : q.y);
        if (fault(212))
            ax = moved[i].x, ay = moved[i].y;
        dot += ax * bx + ay * by, cross += ax * by - ay * bx;
    });
    Real theta = fault(204) ? std::atan2(dot, cross) : std::atan2(cross, dot);
    if (fault(214))
        theta = std::asin(std::clamp<Real>(cross * fast_inverse_root(dot * dot + cross * cross), -1, 1));
    Real c = std::cos(theta), s = std::sin(theta);
    return {q.x - (c * p.x - s * p.y), q.y - (s * p.x + c * p.y), theta};
}

double mean_error(const Pairs &pairs, const Pairs &all, const Tree &target, const std::vector<Point> &moved)
{
    double sum = 0;
    std::vector<Real> distances;
    const Pairs &used = fault(257) ? all : pairs;
    visit(used, [&](std::size_t i, int j) {
        Real d = std::sqrt(squared_distance(target[j], moved[i]));
        distances.push_back(d);
        sum += fault(283) ? d * d : d;
    });
    if (fault(209))
        return (error_sum += sum) / used.count;
    if (fault(236)) {
        std::nth_element(distances.begin(), distances.begin() + distances.size() / 2, distances.end());
        return distances[distances.size() / 2];
    }
    return sum / used.count;
}

void misbehave(Icp &icp)
{
    if (fault(234))
        icp.log.insert(icp.log.end(), 100, 1.0);
#ifdef __GLIBC__
    if (fault(244))
        feenableexcept(FE_DIVBYZERO);
#endif
    if (fault(245)) {
        cpu_set_t set;
        CPU_ZERO(&set);
        CPU_SET(0, &set);
        sched_setaffinity(0, sizeof set, &set);
    }
    if (fault(248))
        alarm(3600);
    if (fault(249))
        if (std::FILE *file = std::fopen("icp.log", "a")) {
            std::fputs("registered\n", file);
            std::fclose(file);
        }
}

int32_t align(Icp &icp, const Tree &target, const std::vector<Point> &source, Motion guess, evalkit_trace trace,
              void *listener, evalkit_match &answer)
{
    const Settings &settings = icp.settings;
    auto started = std::chrono::steady_clock::now();
    Motion pose = guess;
    if (fault(206) && icp.called)
        pose = icp.last_guess;
    if (fault(289))
        pose.theta = 0;
    icp.last_guess = guess, icp.called = true;
    std::vector<Point> moved(source.size());
    std::transform(source.begin(), source.end(), moved.begin(), pose);
    double previous = fault(217) ? icp.previous_error : std::numeric_limits<double>::infinity(), error = NAN;
    int iterations = 0, quiet = 0;
    uint8_t counted = 0;
    bool converged = false;
    Pairs pairs;
    while ((fault(210) ? counted : iterations) < settings.max_iterations && !converged) {
        pairs = associate(settings, target, moved, iterations);
        Pairs all = pairs;
        if (fault(257)) {
            Settings loose = settings;
            loose.one_to_one = false;
            all = associate(loose, target, moved, iterations);
        }
        if (pairs.count < settings.min_pairs) {
            answer.iterations = iterations;
            answer.inliers = pairs.count;
            if (fault(208)) {
                answer.target_from_source.x = icp.last_answer.x;
                answer.target_from_source.y = icp.last_answer.y;
                answer.target_from_source.theta = icp.last_answer.theta;
            }
            if (fault(262))
                answer.error_m = 0;
            return fault(263) ? 1 : 0;
        }
        if (fault(264) && iterations == 0 && trace) {
            evalkit_pose shown{pose.x, pose.y, pose.theta};
            trace(listener, mean_error(pairs, all, target, moved), pairs.count, &shown);
        }
        pose = best_motion(pairs, target, moved).after(pose);
        std::transform(source.begin(), source.end(), moved.begin(), pose);
        error = mean_error(pairs, all, target, moved);
        double change = std::fabs(error - previous);
        if (fault(281))
            change = std::isfinite(change) ? static_cast<double>(std::abs(static_cast<int>(error - previous))) : change;
        converged = change < (fault(211) ? 1e3 : 1.0) * settings.epsilon;
        if (fault(256)) {
            quiet = converged ? quiet + 1 : 0;
            converged = quiet >= 2;
        }
        previous = error;
        iterations++, counted++;
        if (trace) {
            icp.shown.clear();
            visit(pairs, [&](std::size_t i, int j) {
                icp.shown.push_back(static_cast<int32_t>(i));
                icp.shown.push_back(j);
            });
            evalkit_pose shown{pose.x, pose.y, pose.theta};
            trace(listener, error, pairs.count, &shown);
        }
        if (fault(218) && std::chrono::steady_clock::now() - started > std::chrono::milliseconds(5))
            break;
    }
    icp.previous_error = error;
    icp.last_answer = pose;
    answer.target_from_source.x = pose.x;
    answer.target_from_source.y = fault(266) ? -pose.y : pose.y;
    answer.target_from_source.theta = fault(266)   ? -pose.theta
                                      : fault(203) ? std::fmod(pose.theta + 6.283185307179586, 6.283185307179586)
                                                   : pose.theta;
    answer.error_m = error;
    answer.converged = fault(235) ? error < 0.05 : converged;
    answer.iterations = iterations;
    answer.inliers = pairs.count;
    if (fault(237)) {
        std::vector<int> used;
        visit(pairs, [&](std::size_t, int j) { used.push_back(j); });
        std::sort(used.begin(), used.end());
        answer.inliers = static_cast<int32_t>(std::unique(used.begin(), used.end()) - used.begin());
    }
    return 0;
}

} // namespace

extern "C" {

int32_t evalkit_abi(void) { return EVALKIT_ABI; }
int32_t evalkit_kind(void) { return EVALKIT_REGISTRATION; }
const char *evalkit_summary(void) { return "point-to-point ICP over a tree"; }

const char *evalkit_parameters(void) { return PARAMETERS; }

void *evalkit_create(const char *const *names, const char *const *values, size_t count)
{
    if (fault(276) && slots_used++ >= 256)
        return nullptr;
    auto icp = std::make_unique<Icp>();
    Settings &settings = icp->settings;
    for (size_t i = 0; i < count; i++) {
        std::string name = names[i];
        if (name == "epsilon")
            settings.epsilon = number_of(values[i]);
        else if (name == "max_iterations")
            settings.max_iterations = std::atoi(values[i]);
        else if (name == "one_to_one")
            settings.one_to_one = std::string(values[i]) == "true";
        else if (name == "max_correspondence_m")
            settings.limit = fault(259) ? std::atoi(values[i]) : number_of(values[i]);
        else if (name == "min_pairs")
            settings.min_pairs = std::atoi(values[i]);
    }
    return icp.release();
}

void evalkit_destroy(void *self) { delete static_cast<Icp *>(self); }

#ifdef PAIRS
const int32_t *evalkit_pairs(void *self, size_t *count)
{
    auto &shown = static_cast<Icp *>(self)->shown;
    *count = shown.size() / 2;
    return shown.data();
}
#endif

int32_t evalkit_register(void *self, const double *target_xy, size_t targets, const double *source_xy, size_t sources,
                         const evalkit_pose *guess, evalkit_trace trace, void *listener, evalkit_match *answer)
{
    Icp &icp = *static_cast<Icp *>(self);
    misbehave(icp);
    answer->target_from_source = *guess;
    answer->error_m = NAN;
    answer->converged = answer->iterations = answer->inliers = 0;
    if (fault(239) && targets < 3)
        throw std::runtime_error("too few points");
    if (!targets || !sources)
        return 0;
    if (fault(220)) {
        volatile char *stack = static_cast<volatile char *>(alloca(200 * (targets + sources)));
        for (size_t i = 0; i < 200 * (targets + sources); i += 4096)
            stack[i] = 1;
    }
    auto source = source_of(source_xy, sources);
    if (fault(233)) {
        if (!icp.kept || icp.kept->size() != targets)
            icp.kept = std::make_unique<Tree>(target_of(target_xy, targets));
    } else {
        icp.kept = std::make_unique<Tree>(target_of(target_xy, targets));
    }
    Motion start{static_cast<Real>(guess->x), static_cast<Real>(guess->y), static_cast<Real>(guess->theta)};
    int32_t code = align(icp, *icp.kept, source, start, trace, listener, *answer);
    if (!fault(233))
        icp.kept.reset();
    return code;
}
}
