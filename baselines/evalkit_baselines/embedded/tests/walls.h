/* walls.h - a room of 8 m x 6 m with two boxes, and a lidar in it without noise. */
#ifndef EK_TEST_WALLS_H
#define EK_TEST_WALLS_H

#include "ek/se2.h"

#define WALLS 12u

static const double walls[WALLS][4] = {
    {0, 0, 8, 0},       {8, 0, 8, 6},         {8, 6, 0, 6},         {0, 6, 0, 0},
    {2, 2, 3, 2},       {3, 2, 3, 2.5},       {3, 2.5, 2, 2.5},     {2, 2.5, 2, 2},
    {5.5, 3.7, 6.1, 3.7}, {6.1, 3.7, 6.1, 4.8}, {6.1, 4.8, 5.5, 4.8}, {5.5, 4.8, 5.5, 3.7}};

/* Range (m) of a beam at `angle` in the sensor frame. */
static inline double range_at(ek_pose world_from_sensor, double angle)
{
    const double x = (double)world_from_sensor.x, y = (double)world_from_sensor.y;
    const double dx = cos((double)world_from_sensor.theta + angle), dy = sin((double)world_from_sensor.theta + angle);
    double nearest = INFINITY;
    for (unsigned k = 0; k < WALLS; k++) {
        const double ex = walls[k][2] - walls[k][0], ey = walls[k][3] - walls[k][1];
        const double qx = walls[k][0] - x, qy = walls[k][1] - y, cross = dx * ey - dy * ex;
        const double t = (qx * ey - qy * ex) / cross, u = (qx * dy - qy * dx) / cross;
        nearest = cross != 0.0 && t > 0.0 && u >= 0.0 && u <= 1.0 && t < nearest ? t : nearest;
    }
    return nearest;
}

#endif
