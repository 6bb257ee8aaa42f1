/* The ICP of icp.c as a program that speaks evalkit's protocol: exec:./icp, or exec:ssh board ./icp.
 *
 * The protocol's promises (order of keys, no spaces, plain ASCII) make a JSON library unnecessary.
 */
#define _POSIX_C_SOURCE 200809L

#include "icp.h"
#include "lines.h"

static void answer_hello(void)
{
    printf("{\"protocol\":1,\"kind\":\"registration\",\"summary\":\"point-to-point ICP in C, over a pipe\","
           "\"parameters\":["
           "{\"name\":\"max_correspondence_m\",\"default\":0.5,\"unit\":\"m\",\"meaning\":\"largest distance\"},"
           "{\"name\":\"max_iterations\",\"default\":40,\"unit\":\"\",\"meaning\":\"largest number of iterations\"}]}\n");
}

static void answer_create(const char *line, icp_settings *settings)
{
    const char *distance = value_of(line, "\"max_correspondence_m\":");
    const char *iterations = value_of(line, "\"max_iterations\":");
    settings->max_correspondence_m = distance ? atof(distance) : 0.5;
    settings->max_iterations = iterations ? atoi(iterations) : 40;
    printf("{}\n");
}

static void answer_register(const char *line, icp_settings settings, cloud clouds[3])
{
    if (!read_list(line, "\"guess\":", &clouds[0]) || !read_list(line, "\"source\":", &clouds[1]) ||
        !read_list(line, "\"target\":", &clouds[2]) || clouds[0].numbers != 3) {
        printf("{\"failed\":\"the question is not complete, or there is no memory for it\"}\n");
        return;
    }
    long long begun = now_ns();
    const double *guess = clouds[0].xy;
    icp_match start = {0};
    start.x = guess[0], start.y = guess[1], start.theta = guess[2];
    icp_match m = icp_register(settings, clouds[2].xy, clouds[2].numbers / 2, clouds[1].xy, clouds[1].numbers / 2,
                               start, NULL, NULL);
    long long elapsed = now_ns() - begun;
    char error[32] = "null";
    if (is_finite(m.error_m))
        snprintf(error, sizeof error, "%.17g", m.error_m);
    printf("{\"pose\":[%.17g,%.17g,%.17g],\"converged\":%s,\"iterations\":%d,\"error_m\":%s,\"inliers\":%d,"
           "\"elapsed_ns\":%lld}\n",
           m.x, m.y, m.theta, m.converged ? "true" : "false", m.iterations, error, m.inliers, elapsed);
}

int main(void)
{
    char *line = NULL;
    size_t room = 0;
    icp_settings settings = {0.5, 40};
    cloud clouds[3] = {{0}};
    while (getline(&line, &room, stdin) > 0) {
        if (strstr(line, "\"ask\":\"hello\""))
            answer_hello();
        else if (strstr(line, "\"ask\":\"create\""))
            answer_create(line, &settings);
        else if (strstr(line, "\"ask\":\"register\""))
            answer_register(line, settings, clouds);
        else
            printf("{\"failed\":\"unknown question\"}\n");
        fflush(stdout); /* otherwise the answer stays in the buffer */
    }
    for (int i = 0; i < 3; i++)
        free(clouds[i].xy);
    free(line);
    return 0;
}
