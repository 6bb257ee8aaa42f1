#include "ek/sweep_times.h"
#include "ek/sym3.h"

#define FULL (EK_R(300.0) * EK_PI / EK_R(180.0)) /* rad: as in the reference */
#define TURNED (EK_PI / EK_R(90.0))              /* rad: scans between which the robot turned by less tell nothing */
#define MIN_PAIRS 20u
#define SURE EK_R(1.0)      /* m^2: of squared displacements, after which the share is moved: */
#define GAIN EK_R(2.0)      /* times what the residuals tell, */
#define FORGOTTEN EK_R(0.1) /* and by this part towards what is assumed now */
#define SWEEPS EK_R(0.6)    /* from this share on the lidar turns once a scan, */
#define STANDS EK_R(0.3)    /* below this one not any more */
#define CAUCHY EK_R(0.1)    /* m */
#define RIDGE EK_R(1e-6)

int ek_sweep_times_applies(const ek_sweep *sweep)
{
    return sweep->time_increment_ns == 0 && sweep->beams > 1u && sweep->angles &&
           EK_FABS(sweep->angles[sweep->beams - 1u] - sweep->angles[0]) >= FULL;
}

int64_t ek_sweep_times_take(const ek_sweep_times *times, const ek_sweep *sweep, int64_t period_ns)
{
    return ek_sweep_times_applies(sweep) ? times->order * period_ns : 0;
}

/* Sums over pairs: what the pose of the scan moves (free), and what the sweep moves (moved), against the residuals. */
typedef struct {
    ek_sym3 free;
    ek_real left[3], right[3], squared, moved;
    size_t count;
} sums;

static void add_pair(sums *sum, const ek_real row[3], ek_real moved, ek_real residual)
{
    const ek_real far = residual / CAUCHY, weight = EK_R(1.0) / (EK_R(1.0) + far * far);
    sum->count++;
    sum->free.xx += weight * row[0] * row[0];
    sum->free.xy += weight * row[0] * row[1];
    sum->free.xt += weight * row[0] * row[2];
    sum->free.yy += weight * row[1] * row[1];
    sum->free.yt += weight * row[1] * row[2];
    sum->free.tt += weight * row[2] * row[2];
    for (size_t k = 0; k < 3u; k++) {
        sum->left[k] += weight * row[k] * moved;
        sum->right[k] += weight * row[k] * residual;
    }
    sum->squared += weight * moved * moved;
    sum->moved += weight * moved * residual;
}

/* When a point in the frame of the sensor was seen, as a share of the sweep from its middle, -0.5 to 0.5. */
static ek_real time_of(const ek_sweep *sweep, ek_real x, ek_real y)
{
    const ek_real span = sweep->angles[sweep->beams - 1u] - sweep->angles[0], ahead = EK_ATAN2(y, x) - sweep->angles[0];
    const ek_real half_beam = EK_R(0.5) * EK_FABS(span) / (ek_real)(sweep->beams - 1u);
    const ek_real turns = ((span > EK_R(0.0) ? ahead : -ahead) + half_beam) / (EK_R(2.0) * EK_PI);
    return turns - EK_FLOOR(turns) - EK_R(0.5);
}

static void decide(ek_sweep_times *times, ek_real more)
{
    const ek_real order = (ek_real)times->order;
    const ek_real share = times->share + GAIN * more + FORGOTTEN * (order - times->share);
    times->share = share < EK_R(-1.0) ? EK_R(-1.0) : share < EK_R(1.0) ? share : EK_R(1.0);
    if (EK_FABS(times->share) >= SWEEPS) {
        times->order = times->share > EK_R(0.0) ? 1 : -1;
    } else if (EK_FABS(times->share) < STANDS) {
        times->order = 0;
    }
}

static void take(ek_sweep_times *times, sums *sum)
{
    ek_sym3 inverse;
    sum->free.xx += RIDGE;
    sum->free.yy += RIDGE;
    sum->free.tt += RIDGE;
    if (sum->count < MIN_PAIRS || !ek_sym3_inverse(&sum->free, &inverse)) {
        return;
    }
    const ek_real *const v = sum->left, *const w = sum->right;
    const ek_real along[3] = {inverse.xx * v[0] + inverse.xy * v[1] + inverse.xt * v[2],
                              inverse.xy * v[0] + inverse.yy * v[1] + inverse.yt * v[2],
                              inverse.xt * v[0] + inverse.yt * v[1] + inverse.tt * v[2]};
    times->squared += sum->squared - (v[0] * along[0] + v[1] * along[1] + v[2] * along[2]);
    times->moved += sum->moved - (w[0] * along[0] + w[1] * along[1] + w[2] * along[2]);
    if (times->squared >= SURE) {
        decide(times, times->moved / times->squared);
        times->squared = times->moved = EK_R(0.0);
    }
}

void ek_sweep_times_observe(ek_sweep_times *times, const ek_observer *observer, const ek_index *map, ek_pose pose,
                            ek_real limit, const ek_sweep *sweep, ek_pose base_from_sensor, const ek_sweep_step *step)
{
    const ek_real c = EK_COS(pose.theta), s = EK_SIN(pose.theta);
    const ek_real share = step->period_ns > 0 ? (ek_real)step->period_ns / (ek_real)step->elapsed_ns : EK_R(0.0);
    const ek_pose sensor_from_base = ek_se2_inverse(base_from_sensor), turned = step->step;
    sums sum = {.count = 0u};
    if (!(share > EK_R(0.0)) || EK_FABS(turned.theta) < TURNED) {
        return;
    }
    for (size_t k = 0; k < observer->cells && map->count > 0u; k += observer->every) {
        const ek_real x = observer->thinned[2u * k], y = observer->thinned[2u * k + 1u];
        const ek_real u = observer->normals[2u * k], v = observer->normals[2u * k + 1u];
        const ek_real at_x = c * x - s * y + pose.x, at_y = s * x + c * y + pose.y;
        const ek_neighbour nearest = ek_index_nearest(map, at_x, at_y, limit, limit);
        if (nearest.slot != EK_NONE) {
            const ek_real gap_x = map->xy[2u * nearest.slot] - at_x, gap_y = map->xy[2u * nearest.slot + 1u] - at_y;
            const ek_real residual = (c * gap_x + s * gap_y) * u + (c * gap_y - s * gap_x) * v;
            const ek_real row[3] = {u, v, x * v - y * u};
            ek_real seen[2] = {x, y};
            ek_se2_transform(sensor_from_base, seen, 1u, seen);
            const ek_real moved = (turned.x * u + turned.y * v + turned.theta * row[2]) * share;
            add_pair(&sum, row, moved * time_of(sweep, seen[0], seen[1]), residual);
        }
    }
    take(times, &sum);
}
