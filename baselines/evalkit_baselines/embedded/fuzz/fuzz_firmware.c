/* Messages to the example firmware, of every type, with odd numbers, cut short, too long or of arbitrary bytes, in frames on its
 * line: each is answered by one busy frame and one answer, 'a' with the bytes of its type and finite poses, or 'f' with a
 * reason. A message that says more than it has is refused. firmware.c is compiled beside it, its main as firmware_main. */
#include "input.h"

#include "../board/link.h"
#include "../board/port.h"

#define MESSAGE (64u * 1024u)

int firmware_main(void);

static unsigned char message[MESSAGE], sent[2u * MESSAGE], answer[8u * LINK_CODED];
static size_t message_bytes, sent_bytes, sent_taken, answer_bytes;
static unsigned char sequence;
static uint32_t points, targets; /* that the firmware takes at most */
static char session;             /* kind of the last one that began */

void port_init(void)
{
}

int port_read(void)
{
    return sent_taken < sent_bytes ? sent[sent_taken++] : -1;
}

void port_write(unsigned char byte)
{
    HOLDS(answer_bytes < sizeof answer);
    answer[answer_bytes++] = byte;
}

uint64_t port_clock_ns(void)
{
    static uint64_t now;
    return now += 5000000000u;
}

static void put(const void *bytes, size_t count)
{
    HOLDS(count <= MESSAGE - message_bytes);
    memcpy(message + message_bytes, bytes, count);
    message_bytes += count;
}

static void put_double(double value)
{
    put(&value, sizeof value);
}

static void put_whole(uint32_t value)
{
    put(&value, sizeof value);
}

static void put_doubles(ek_input *input, size_t count)
{
    for (size_t k = 0; k < count; k++) {
        put_double((double)take_real(input));
    }
}

static void put_reals(ek_input *input, size_t count)
{
    for (size_t k = 0; k < count; k++) {
        const ek_real value = take_real(input);
        put(&value, sizeof value);
    }
}

/* A number of points or beams: mostly what the firmware takes, sometimes one more, or any. */
static uint32_t take_count(ek_input *input, uint32_t most)
{
    const uint8_t kind = take_byte(input);
    return kind < 250u ? kind % (most + 1u) : kind < 253u ? most + 1u : (uint32_t)take_whole(input);
}

static void put_create(ek_input *input)
{
    static const double odd[] = {NAN, INFINITY, -1.0, 0.5, 1e12, -1e300};
    const uint8_t kind = take_byte(input);
    if (kind < 40u) {
        put("s", 1u);
        put_double(kind < 36u ? 1000.0 * kind : odd[kind % (sizeof odd / sizeof *odd)]);
        return;
    }
    put(kind < 140u ? "r" : kind < 240u ? "o" : "x", 1u);
    for (int k = 0; k < 2; k++) { /* few iterations: the fuzzer has no patience */
        const uint8_t whole = take_byte(input);
        put_double(whole < 240u ? (double)(whole % 40u) : odd[whole % (sizeof odd / sizeof *odd)]);
    }
    put_doubles(input, 2u);
    put_double((double)(kind % 2u));
}

static void put_register(ek_input *input)
{
    put_doubles(input, 3u);
    const uint32_t source = take_count(input, points), target = take_count(input, targets);
    put_whole(source);
    put_whole(target);
    put_reals(input, 2u * (source % 256u + target % 256u));
}

static void put_update(ek_input *input)
{
    const uint8_t flags = take_byte(input);
    put_double(flags & 4u ? 0.1 : (double)take_real(input));
    put_double(flags & 4u ? 12.0 : (double)take_real(input));
    put_doubles(input, 3u);
    for (int k = 0; k < 2; k++) {
        const int64_t time = take_time(input);
        put(&time, sizeof time);
    }
    const uint32_t beams = take_count(input, points);
    put_whole(beams);
    put_whole(flags);
    put_doubles(input, 3u * ((flags & 1u) + (flags >> 1 & 1u)));
    put_reals(input, 2u * (beams % 256u));
}

static void put_tracked(ek_input *input)
{
    const uint32_t scans = take_count(input, 20u);
    put_whole(scans);
    for (uint32_t k = 0; k < scans % 32u; k++) {
        put_whole(take_count(input, 8u));
        put_doubles(input, 3u);
    }
}

/* Make the next message; its type. */
static char make_message(ek_input *input)
{
    static const char types[] = "HCRUCRURUUTL";
    const uint8_t kind = take_byte(input), cut = take_byte(input);
    const char type = types[kind % (sizeof types - 1u)];
    message_bytes = 0u;
    put(&type, 1u);
    if (kind >= 240u) { /* arbitrary bytes */
        unsigned char bytes[200];
        take(input, bytes, sizeof bytes);
        put(bytes, cut % sizeof bytes);
    } else if (type == 'C') {
        put_create(input);
    } else if (type == 'R') {
        put_register(input);
    } else if (type == 'U') {
        put_update(input);
    } else if (type == 'T') {
        put_tracked(input);
    } else if (type == 'L') {
        put_whole(take_count(input, 4u));
    }
    if (cut >= 250u) {
        put("surplus", (size_t)cut - 249u);
    } else if (cut >= 240u && message_bytes > 16u) {
        message_bytes -= (size_t)cut - 239u;
    }
    return type;
}

/* Send the message in frames; the firmware takes it and answers. */
static void send(int first)
{
    sent_bytes = sent_taken = answer_bytes = 0u;
    sent[sent_bytes++] = 0u; /* ends what is left on the line */
    for (size_t at = 0; at < message_bytes; at += LINK_DATA) {
        unsigned char frame[LINK_FRAME];
        const size_t count = message_bytes - at < LINK_DATA ? message_bytes - at : LINK_DATA;
        frame[0] = ++sequence;
        frame[1] = (unsigned char)((first && !at ? LINK_FIRST : 0) | (at + count == message_bytes ? LINK_LAST : 0));
        memcpy(frame + 2, message + at, count);
        const uint32_t sum = link_checksum(frame, 2u + count);
        for (size_t k = 0; k < 4u; k++) {
            frame[2u + count + k] = (unsigned char)(sum >> 8u * k);
        }
        sent_bytes += link_encode(frame, count + 6u, sent + sent_bytes);
    }
    HOLDS(firmware_main() == 0);
}

/* The data of the last frame, after a busy one, if the firmware took the message; NULL if it is too long for it. */
static const unsigned char *check_frames(size_t *bytes)
{
    unsigned char *frame = answer, *before = NULL, *last = NULL;
    size_t last_bytes = 0u;
    while (frame < answer + answer_bytes) {
        HOLDS(*frame == 0u); /* ends what the firmware may have printed */
        frame++;
        unsigned char *const end = (unsigned char *)memchr(frame, 0, (size_t)(answer + answer_bytes - frame));
        HOLDS(end != NULL);
        before = last;
        last = frame;
        last_bytes = link_decode(frame, (size_t)(end - frame));
        HOLDS(last_bytes >= 2u);
        frame = end + 1;
    }
    HOLDS(last && last[0] == sequence && last[1] & LINK_LAST);
    if (last[1] & LINK_TOO_LONG) {
        return NULL;
    }
    HOLDS(before && before[0] == sequence && before[1] == LINK_BUSY);
    *bytes = last_bytes - 2u;
    return last + 2;
}

static void check_pose(const unsigned char *from)
{
    double pose[3];
    memcpy(pose, from, sizeof pose);
    HOLDS(isfinite(pose[0]) && isfinite(pose[1]) && isfinite(pose[2]));
}

static void check_answer(char type, const unsigned char *data, size_t bytes)
{
    HOLDS(bytes >= (type == 'T' ? 1u : 2u) && (data[0] == 'a' || data[0] == 'f'));
    if (data[0] == 'f') {
        for (size_t k = 1; k < bytes; k++) {
            HOLDS(data[k] >= ' ' && data[k] <= '~');
        }
        return;
    }
    if (type == 'C') {
        session = (char)message[1];
    }
    if (type == 'R' || type == 'U') {
        check_pose(data + 1);
    }
    if (type == 'T') { /* a pose for each scan */
        HOLDS(bytes == 1u + (message_bytes - 5u) / 28u * 24u);
        for (const unsigned char *pose = data + 1; pose < data + bytes; pose += 24) {
            check_pose(pose);
        }
    } else if (type == 'L') {
        HOLDS(bytes >= 5u && (bytes - 5u) % 56u == 0u);
    } else {
        const size_t of_update = session == 's' ? 64u : 32u;
        HOLDS(type == 'H' || bytes == 1u + (type == 'C' ? 4u : type == 'R' ? 52u : of_update));
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    ek_input input = {bytes, size};
    size_t count = 0u;
    message_bytes = 0u;
    put("Cx", 2u); /* refused: ends the session of the input before */
    send(1);
    const unsigned char *data = check_frames(&count);
    HOLDS(data && data[0] == 'f');
    message_bytes = 0u;
    put("H", 1u);
    send(0);
    data = check_frames(&count);
    HOLDS(data && data[0] == 'a' && count > 13u);
    memcpy(&points, data + 5, sizeof points);
    memcpy(&targets, data + 9, sizeof targets);
    for (int number = 0; number < 12 && input.left; number++) {
        const char type = make_message(&input);
        send(0);
        data = check_frames(&count);
        if (data) {
            check_answer(type, data, count);
        }
    }
    return 0;
}
