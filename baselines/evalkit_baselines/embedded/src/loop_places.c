/* Which place loop_finder.h compares next with the last keyframe. */
#include "loop_parts.h"

#include <string.h>

#define ALL 2u    /* turns at which the next of all places is compared, */
#define AROUND 3u /* and a place around where the robot seems to be, as if the graph predicted no motion */

/* The keyframe nearest to a pose that is far apart through the graph, within the radius that the drift since then allows. */
static size_t nearest_place(const ek_loop_finder *finder, const ek_keyframes *keyframes, ek_pose last)
{
    const ek_loop_settings *const settings = &finder->settings;
    const ek_pose *const pose = keyframes->graph.pose;
    ek_real least = EK_FAR;
    size_t place = keyframes->count;
    for (size_t k = 0; k < keyframes->count; k++) {
        const ek_real apart = keyframes->apart[k], x = pose[k].x - last.x, y = pose[k].y - last.y;
        const ek_real distance = EK_SQRT(x * x + y * y), grown = EK_R(1.0) + EK_R(0.1) * apart;
        const ek_real radius = grown < settings->radius ? grown : settings->radius;
        if (apart >= settings->path && apart < EK_DOUBTED && distance <= radius && distance < least) {
            least = distance;
            place = k;
        }
    }
    return place;
}

/* The place of another part of the drive nearest to where the robot seems to be, within the radius. */
static size_t nearest_other_part(const ek_loop_finder *finder, const ek_keyframes *keyframes, ek_pose last)
{
    const ek_pose *const pose = keyframes->graph.pose;
    ek_real least = EK_FAR;
    size_t place = keyframes->count;
    for (size_t k = 0; k < keyframes->count; k++) {
        const ek_real x = pose[k].x - last.x, y = pose[k].y - last.y, distance = EK_SQRT(x * x + y * y);
        if (keyframes->apart[k] >= EK_DOUBTED && distance < least) {
            least = distance;
            place = k;
        }
    }
    return least <= finder->settings.radius ? place : keyframes->count;
}

/* The next place of the parts that are not connected, half a radius of path after the last one. There must be one. */
static size_t next_of_all(ek_loop_finder *finder, const ek_keyframes *keyframes)
{
    const size_t count = keyframes->count;
    const ek_real from = keyframes->path[finder->next_place < count ? finder->next_place : count - 1u];
    size_t first = count, ahead = count;
    for (size_t k = count; k-- > 0u;) {
        if (keyframes->apart[k] >= EK_DOUBTED) {
            first = k;
            ahead = keyframes->path[k] >= from ? k : ahead;
        }
    }
    ahead = ahead < count ? ahead : first; /* after the last one the first again */
    size_t next = 0u;
    while (next < count && keyframes->path[next] < keyframes->path[ahead] + EK_R(0.5) * finder->settings.radius) {
        next++;
    }
    finder->next_place = next;
    return ahead;
}

/* 1 if some part of the drive is not connected with the last keyframe. */
static int is_apart(const ek_keyframes *keyframes)
{
    for (size_t k = 0; k < keyframes->count; k++) {
        if (keyframes->apart[k] >= EK_DOUBTED) {
            return 1;
        }
    }
    return 0;
}

/* A place to compare with the last keyframe: `pose`, where the robot seems to be, `known`, whether the graph predicts it,
 * and `turned`, whether not even the heading is predicted. */
typedef struct {
    size_t row; /* keyframes->count: there is none */
    ek_pose pose;
    int known, turned;
} place;

/* Beside an unconfirmed candidate. */
static place expected_place(const ek_loop_finder *finder, const ek_keyframes *keyframes, const ek_loop_candidate *beside)
{
    const ek_pose *const poses = keyframes->graph.pose;
    const ek_loop_edge *const edge = &beside->edge;
    const ek_pose then = ek_se2_compose(poses[edge->first], edge->first_from_second);
    const ek_pose pose = ek_se2_compose(then, ek_se2_between(poses[edge->second], poses[keyframes->count - 1u]));
    const int connected = keyframes->apart[edge->first] < EK_DOUBTED;
    const place found = {connected ? nearest_place(finder, keyframes, pose) : nearest_other_part(finder, keyframes, pose),
                         pose, beside->known, 0};
    return found;
}

/* The nearest place. While another part of the drive is not connected, five turns follow each other:
 * 1 and 4: the other part's place nearest to where the robot seems to be, within what the graph predicts by the odometry since;
 * 2: the next of all places;
 * 3: the other part's nearest place within the radius;
 * 5: the nearest place of the own part.
 * A turn without such a prediction, or such a place, is as the second. */
static place next_place(ek_loop_finder *finder, const ek_keyframes *keyframes, int measured)
{
    const ek_pose pose = keyframes->graph.pose[keyframes->count - 1u];
    place found = {nearest_place(finder, keyframes, pose), pose, 1, 0};
    if (!is_apart(keyframes)) {
        return found;
    }
    finder->turn = (finder->turn + 1u) % 5u;
    const size_t near = nearest_other_part(finder, keyframes, pose);
    const int is_near = near < keyframes->count;
    const int known = is_near && measured && keyframes->apart[near] < EK_APART;
    if (finder->turn == 0u && found.row < keyframes->count) {
        return found;
    }
    const int looks_near = is_near && (finder->turn == 1u || finder->turn == AROUND || (known && finder->turn != ALL));
    found.row = looks_near ? near : next_of_all(finder, keyframes);
    found.known = looks_near && known && finder->turn != AROUND;
    found.turned = !looks_near || !measured;
    return found;
}

int ek_loop_finder_begin(ek_loop_finder *finder, ek_keyframes *keyframes, const ek_loop_candidate *expected, int measured,
                         ek_work *work)
{
    const ek_sym3 anywhere = {EK_R(1e4), EK_R(0.0), EK_R(0.0), EK_R(1e4), EK_R(0.0), EK_R(1e2)};
    const ek_pose identity = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    const size_t count = keyframes->count, last = count - 1u;
    if (count < 2u || (finder->tried && keyframes->path[last] - finder->tried_at < finder->settings.spacing)) {
        return 0;
    }
    place at = {count, identity, 0, 0};
    if (expected) {
        at = expected_place(finder, keyframes, expected);
    }
    if (at.row == count) {
        at = next_place(finder, keyframes, measured);
    }
    ek_work_spend(work, 4u * (uint64_t)count);
    if (at.row >= last) {
        return 0;
    }
    const ek_pose *const poses = keyframes->graph.pose;
    finder->tried = 1;
    finder->tried_at = keyframes->path[last];
    finder->apart = keyframes->apart[at.row] >= EK_DOUBTED;
    finder->turned = at.turned;
    finder->motion = at.turned ? identity : ek_se2_between(poses[at.row], at.known ? poses[last] : at.pose);
    finder->covariance = anywhere;
    memset(&finder->candidate, 0, sizeof finder->candidate);
    finder->candidate.known = at.known;
    finder->candidate.edge.first = (uint32_t)at.row;
    finder->candidate.edge.second = (uint32_t)last;
    finder->candidate.edge.first_from_second = finder->motion;
    finder->candidate.chi = (ek_real)NAN;
    finder->phase = EK_FINDER_PREDICT;
    return !at.known || ek_pose_graph_predict(&keyframes->graph, (uint32_t)at.row, (uint32_t)last) == EK_OK;
}
