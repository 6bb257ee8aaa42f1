// An odometry in C++17 as a shared library: every scan is matched against the last keyframe. lib:./libodometry.so
#include <cmath>
#include <cstdlib>
#include <limits>
#include <string>
#include <vector>

#include "evalkit_backend.h"

namespace {

struct Point {
    double x, y;
};

evalkit_pose operator*(const evalkit_pose &a, const evalkit_pose &b)  // a_from_c = a_from_b * b_from_c
{
    const double c = std::cos(a.theta), s = std::sin(a.theta);
    return {a.x + c * b.x - s * b.y, a.y + s * b.x + c * b.y, a.theta + b.theta};
}

evalkit_pose inverse(const evalkit_pose &a)
{
    const double c = std::cos(a.theta), s = std::sin(a.theta);
    return {-c * a.x - s * a.y, s * a.x - c * a.y, -a.theta};
}

Point moved(const evalkit_pose &a, const Point &p)
{
    const double c = std::cos(a.theta), s = std::sin(a.theta);
    return {a.x + c * p.x - s * p.y, a.y + s * p.x + c * p.y};
}

class Odometry {
public:
    Odometry(double keyframe_m, double max_correspondence_m, int max_iterations)
        : keyframe_m_(keyframe_m), squared_limit_(max_correspondence_m * max_correspondence_m),
          max_iterations_(max_iterations)
    {
    }

    evalkit_pose update(const evalkit_frame &frame)
    {
        const std::vector<Point> scan = points_of(frame);
        if (keyframe_.empty()) {
            keyframe_ = scan;
        } else {
            evalkit_pose step = step_;  // constant velocity, or wheel odometry where available
            if (frame.odom_from_base && has_wheels_) step = inverse(wheels_) * *frame.odom_from_base;
            const evalkit_pose before = start_from_base_;
            const evalkit_pose guess = inverse(start_from_keyframe_) * before * step;
            start_from_base_ = start_from_keyframe_ * match(scan, guess);
            step_ = inverse(before) * start_from_base_;
            const evalkit_pose away = inverse(start_from_keyframe_) * start_from_base_;
            if (std::hypot(away.x, away.y) > keyframe_m_ || std::fabs(away.theta) > 0.3) {
                keyframe_ = scan;
                start_from_keyframe_ = start_from_base_;
            }
        }
        has_wheels_ = frame.odom_from_base != nullptr;
        if (has_wheels_) wheels_ = *frame.odom_from_base;
        return start_from_base_;
    }

private:
    // The hits in the base's frame, each moved back to the first beam by its share of the motion within the scan.
    std::vector<Point> points_of(const evalkit_frame &frame) const
    {
        std::vector<Point> points;
        for (std::size_t i = 0; i < frame.beams; ++i) {
            if (!std::isfinite(frame.ranges[i])) continue;
            const Point hit{frame.ranges[i] * std::cos(frame.angles[i]), frame.ranges[i] * std::sin(frame.angles[i])};
            const Point in_base = moved(frame.base_from_sensor, hit);
            const double share = frame.start_from_end ? double(i) / double(frame.beams) : 0.0;
            const evalkit_pose end = frame.start_from_end ? *frame.start_from_end : evalkit_pose{0.0, 0.0, 0.0};
            points.push_back(moved({share * end.x, share * end.y, share * end.theta}, in_base));
        }
        return points;
    }

    evalkit_pose match(const std::vector<Point> &scan, evalkit_pose keyframe_from_base) const
    {
        for (int iteration = 0; iteration < max_iterations_; ++iteration) {
            double n = 0, px = 0, py = 0, qx = 0, qy = 0, dot = 0, cross = 0;
            for (const Point &point : scan) {
                const Point p = moved(keyframe_from_base, point);
                double best = squared_limit_;
                const Point *q = nullptr;
                for (const Point &candidate : keyframe_) {
                    const double dx = candidate.x - p.x, dy = candidate.y - p.y;
                    if (dx * dx + dy * dy <= best) best = dx * dx + dy * dy, q = &candidate;
                }
                if (!q) continue;
                n += 1, px += p.x, py += p.y, qx += q->x, qy += q->y;
                dot += p.x * q->x + p.y * q->y;
                cross += p.x * q->y - p.y * q->x;
            }
            if (n < 10) break;
            const double turn = std::atan2(cross - (px * qy - py * qx) / n, dot - (px * qx + py * qy) / n);
            const Point centre = moved({0.0, 0.0, turn}, {px / n, py / n});
            const evalkit_pose step{qx / n - centre.x, qy / n - centre.y, turn};
            keyframe_from_base = step * keyframe_from_base;
            if (std::hypot(step.x, step.y) + std::fabs(turn) < 1e-5) break;
        }
        return keyframe_from_base;
    }

    double keyframe_m_, squared_limit_;
    int max_iterations_;
    std::vector<Point> keyframe_;
    evalkit_pose start_from_base_{0.0, 0.0, 0.0}, start_from_keyframe_{0.0, 0.0, 0.0}, step_{0.0, 0.0, 0.0}, wheels_{};
    bool has_wheels_ = false;
};

std::string last_error;

}  // namespace

extern "C" {

int32_t evalkit_abi(void) { return EVALKIT_ABI; }

int32_t evalkit_kind(void) { return EVALKIT_ODOMETRY; }

const char *evalkit_summary(void) { return "scan-to-keyframe ICP in C++, brute-force neighbours"; }

const char *evalkit_parameters(void)
{
    return "keyframe_m 0.3 m a new keyframe after this distance\n"
           "max_correspondence_m 0.5 m largest distance of a pair\n"
           "max_iterations 40 - largest number of iterations\n";
}

void *evalkit_create(const char *const *, const char *const *values, size_t count)
try {
    if (count != 3) {
        last_error = "expected the three declared parameters";
        return nullptr;
    }
    return new Odometry(std::atof(values[0]), std::atof(values[1]), std::atoi(values[2]));
} catch (const std::exception &error) {  // no exception may leave the C interface
    last_error = error.what();
    return nullptr;
}

int32_t evalkit_update(void *self, const evalkit_frame *frame, evalkit_pose *answer)
try {
    *answer = static_cast<Odometry *>(self)->update(*frame);
    return 0;
} catch (const std::exception &error) {
    last_error = error.what();
    return 1;
}

void evalkit_destroy(void *self) { delete static_cast<Odometry *>(self); }

const char *evalkit_last_error(void *) { return last_error.c_str(); }

}
