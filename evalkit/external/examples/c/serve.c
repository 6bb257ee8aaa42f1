/* Any registration with the functions of evalkit_backend.h as a program: on a board, or for another processor.
 *
 *     aarch64-linux-gnu-gcc -static -I DIR serve.c mine.c -o mine -lm        DIR: the folder of evalkit_backend.h
 *     evalkit validate 'exec:qemu-aarch64 ./mine'                            or 'exec:ssh board ./mine'
 */
#define _POSIX_C_SOURCE 200809L

#include "evalkit_backend.h"
#include "lines.h"

#define MOST 32 /* parameters */

typedef struct {
    char name[64], value[64], unit[32], meaning[160];
} parameter;

static parameter parameters[MOST];
static size_t count;

static void read_declaration(void)
{
    const char *text = evalkit_parameters();
    while (text && *text && count < MOST) {
        parameter *one = &parameters[count];
        if (sscanf(text, "%63s %63s %31s %159[^\n]", one->name, one->value, one->unit, one->meaning) == 4)
            count++;
        text = strchr(text, '\n');
        text = text ? text + 1 : NULL;
    }
}

static int is_plain(const char *value) /* true, false or a number, which JSON writes without quotation marks */
{
    char *end;
    strtod(value, &end);
    return !*end || !strcmp(value, "true") || !strcmp(value, "false");
}

static void answer_hello(void)
{
    printf("{\"protocol\":1,\"kind\":\"registration\",\"summary\":\"%s\",\"parameters\":[", evalkit_summary());
    for (size_t i = 0; i < count; i++) {
        const parameter *one = &parameters[i];
        const char *mark = is_plain(one->value) ? "" : "\"";
        printf("%s{\"name\":\"%s\",\"default\":%s%s%s,\"unit\":\"%s\",\"meaning\":\"%s\"}", i ? "," : "", one->name, mark,
               one->value, mark, strcmp(one->unit, "-") ? one->unit : "", one->meaning);
    }
    printf(",{\"name\":\"trace\",\"default\":false,\"unit\":\"\",\"meaning\":\"report every iteration\"}]}\n");
}

static void *create(const char *line, int *traced)
{
    const char *names[MOST], *values[MOST], *trace = value_of(line, "\"trace\":");
    for (size_t i = 0; i < count; i++) {
        char key[80];
        snprintf(key, sizeof key, "\"%.63s\":", parameters[i].name);
        const char *at = value_of(line, key);
        if (at)
            sscanf(at + (*at == '"'), "%63[^,}\"]", parameters[i].value);
        names[i] = parameters[i].name, values[i] = parameters[i].value;
    }
    *traced = trace && *trace == 't';
    return evalkit_create(names, values, count);
}

static void print_pose(const evalkit_pose *pose, double error_m, int32_t inliers)
{
    printf("\"pose\":[%.17g,%.17g,%.17g],\"inliers\":%d,\"error_m\":", pose->x, pose->y, pose->theta, (int)inliers);
    printf(is_finite(error_m) ? "%.17g" : "null", error_m);
}

static void record(void *entries, double error_m, int32_t inliers, const evalkit_pose *pose)
{
    printf((*(int *)entries)++ ? ",{" : "{");
    print_pose(pose, error_m, inliers);
    printf("}");
}

static void answer_register(const char *line, void *self, int traced, cloud clouds[3])
{
    evalkit_match match;
    int entries = 0;
    if (!self || !read_list(line, "\"guess\":", &clouds[0]) || !read_list(line, "\"source\":", &clouds[1]) ||
        !read_list(line, "\"target\":", &clouds[2]) || clouds[0].numbers != 3) {
        printf("{\"failed\":\"the question is not complete, or there is no object or memory for it\"}\n");
        return;
    }
    evalkit_pose guess = {clouds[0].xy[0], clouds[0].xy[1], clouds[0].xy[2]};
    printf("{\"trace\":[");
    long long begun = now_ns();
    int32_t code = evalkit_register(self, clouds[2].xy, clouds[2].numbers / 2, clouds[1].xy, clouds[1].numbers / 2, &guess,
                                    traced ? record : NULL, &entries, &match);
    long long elapsed = now_ns() - begun;
    printf("],\"elapsed_ns\":%lld,", elapsed);
    if (code) {
        printf("\"failed\":\"evalkit_register returned %d\"}\n", (int)code);
        return;
    }
    print_pose(&match.target_from_source, match.error_m, match.inliers);
    printf(",\"converged\":%s,\"iterations\":%d}\n", match.converged ? "true" : "false", (int)match.iterations);
}

int main(void)
{
    char *line = NULL;
    size_t room = 0;
    int traced = 0;
    void *self = NULL;
    cloud clouds[3] = {{0}};
    read_declaration();
    while (getline(&line, &room, stdin) > 0) {
        if (strstr(line, "\"ask\":\"hello\""))
            answer_hello();
        else if (strstr(line, "\"ask\":\"create\"")) {
            self = create(line, &traced);
            printf(self ? "{}\n" : "{\"failed\":\"evalkit_create returned NULL\"}\n");
        } else
            answer_register(line, self, traced, clouds);
        fflush(stdout);
    }
    if (self)
        evalkit_destroy(self);
    for (int i = 0; i < 3; i++)
        free(clouds[i].xy);
    free(line);
    return 0;
}
