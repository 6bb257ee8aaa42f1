// MRPT's 2D ICP as a registration in C++17: evalkit's front end makes it an odometry. lib:./libmrpt_icp.so
// Needs MRPT 2 (BSD licence; Debian and Ubuntu: libmrpt-slam-dev); pkg-config gives the flags, see README.md.
#include <mrpt/maps/CSimplePointsMap.h>
#include <mrpt/poses/CPosePDF.h>
#include <mrpt/slam/CICP.h>

#include <cmath>
#include <cstdlib>
#include <limits>
#include <map>
#include <string>

#include "evalkit_backend.h"

namespace {

// Levenberg-Marquardt on interpolated distances, or the classic closed form.
struct Registration {
    mrpt::slam::CICP icp;
    double largest_m = 0.0;

    explicit Registration(const std::map<std::string, std::string> &given)
    {
        icp.setMinLoggingLevel(mrpt::system::LVL_ERROR);
        const auto number = [&](const char *name) { return std::atof(given.at(name).c_str()); };
        auto &o = icp.options;
        o.ICP_algorithm = given.at("levenberg_marquardt") == "true" ? mrpt::slam::icpLevenbergMarquardt
                                                                     : mrpt::slam::icpClassic;
        o.maxIterations = unsigned(number("max_iterations"));
        o.thresholdDist = largest_m = number("max_correspondence_m");
        o.smallestThresholdDist = number("last_correspondence_m");
        o.thresholdAng = number("max_correspondence_deg") * M_PI / 180.0;
        o.ALFA = number("shrinking");
        o.skip_cov_calculation = true;
        o.corresponding_points_decimation = 1;
    }
};

mrpt::maps::CSimplePointsMap map_of(const double *xy, std::size_t count)
{
    mrpt::maps::CSimplePointsMap map;
    map.reserve(count);
    for (std::size_t i = 0; i < count; ++i) map.insertPoint(float(xy[2 * i]), float(xy[2 * i + 1]), 0.0F);
    return map;
}

std::string last_error;

}  // namespace

extern "C" {

int32_t evalkit_abi(void) { return EVALKIT_ABI; }

int32_t evalkit_kind(void) { return EVALKIT_REGISTRATION; }

const char *evalkit_summary(void) { return "MRPT's 2D ICP (CICP), classic or Levenberg-Marquardt"; }

const char *evalkit_parameters(void)
{
    return "levenberg_marquardt false - Levenberg-Marquardt instead of the closed form\n"
           "max_iterations 80 - largest number of iterations\n"
           "max_correspondence_m 0.3 m largest distance of a pair in the first iterations\n"
           "last_correspondence_m 0.05 m and in the last ones\n"
           "max_correspondence_deg 0.15 deg grows the distance with the range of a point\n"
           "shrinking 0.5 - factor from one largest distance to the next\n";
}

void *evalkit_create(const char *const *names, const char *const *values, size_t count)
try {
    std::map<std::string, std::string> given;
    for (std::size_t i = 0; i < count; ++i) given[names[i]] = values[i];
    return new Registration(given);
} catch (const std::exception &error) {  // no exception may leave the C interface
    last_error = error.what();
    return nullptr;
}

int32_t evalkit_register(void *self, const double *target_xy, size_t targets, const double *source_xy, size_t sources,
                         const evalkit_pose *guess, evalkit_trace, void *, evalkit_match *answer)
try {
    *answer = {*guess, std::numeric_limits<double>::quiet_NaN(), 0, 0, 0};
    if (targets < 3 || sources < 3) return 0;
    const auto target = map_of(target_xy, targets), source = map_of(source_xy, sources);
    mrpt::slam::CICP::TReturnInfo info;
    auto &icp = static_cast<Registration *>(self)->icp;
    const auto pose = icp.Align(&target, &source, {guess->x, guess->y, guess->theta}, info)->getMeanVal();
    answer->iterations = int32_t(info.nIterations);
    answer->inliers = int32_t(std::lround(info.goodness * double(sources)));
    if (answer->inliers < 3) return 0;
    answer->target_from_source = {pose.x(), pose.y(), pose.phi()};
    answer->converged = info.nIterations < icp.options.maxIterations;
    return 0;
} catch (const std::exception &error) {
    last_error = error.what();
    return 1;
}

void evalkit_destroy(void *self) { delete static_cast<Registration *>(self); }

const char *evalkit_last_error(void *) { return last_error.c_str(); }

}
