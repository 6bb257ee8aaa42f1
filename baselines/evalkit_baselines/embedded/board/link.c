#include "link.h"

#include <string.h>

#define CHECKSUM 4u
#define HEAD 2u

uint32_t link_checksum(const unsigned char *bytes_in, size_t bytes)
{
    uint32_t sum = 0xffffffffu;
    for (size_t i = 0; i < bytes; i++) {
        sum ^= bytes_in[i];
        for (int bit = 0; bit < 8; bit++) {
            sum = sum >> 1 ^ (sum & 1u ? 0xedb88320u : 0u);
        }
    }
    return ~sum;
}

size_t link_encode(const unsigned char *bytes_in, size_t bytes, unsigned char *coded)
{
    size_t code = 0u, to = 1u;
    unsigned char run = 1u;
    for (size_t i = 0; i < bytes; i++) {
        if (bytes_in[i]) {
            coded[to++] = bytes_in[i];
            run++;
        }
        if (!bytes_in[i] || run == 255u) {
            coded[code] = run;
            code = to++;
            run = 1u;
        }
    }
    coded[code] = run;
    coded[to++] = 0u;
    return to;
}

size_t link_decode(unsigned char *coded, size_t bytes)
{
    size_t to = 0u;
    for (size_t from = 0; from < bytes;) {
        const unsigned char run = coded[from++];
        if (run == 0u || (size_t)run - 1u > bytes - from) {
            return 0u;
        }
        memmove(coded + to, coded + from, (size_t)run - 1u);
        to += (size_t)run - 1u;
        from += (size_t)run - 1u;
        if (run < 255u && from < bytes) {
            coded[to++] = 0u;
        }
    }
    if (to < HEAD + CHECKSUM || to > LINK_FRAME) {
        return 0u;
    }
    uint32_t sum = 0u;
    for (size_t k = CHECKSUM; k-- > 0u;) {
        sum = sum << 8 | coded[to - CHECKSUM + k];
    }
    return sum == link_checksum(coded, to - CHECKSUM) ? to - CHECKSUM : 0u;
}

static void encode_frame(link_state *link, unsigned char flags, const unsigned char *data, size_t bytes)
{
    unsigned char frame[LINK_FRAME];
    frame[0] = link->sequence;
    frame[1] = flags;
    if (bytes) {
        memcpy(frame + HEAD, data, bytes);
    }
    const uint32_t sum = link_checksum(frame, HEAD + bytes);
    for (size_t k = 0; k < CHECKSUM; k++) {
        frame[HEAD + bytes + k] = (unsigned char)(sum >> 8u * k);
    }
    link->answer_bytes = link_encode(frame, HEAD + bytes + CHECKSUM, link->answer);
}

void link_answer(link_state *link, const unsigned char *data, size_t bytes)
{
    encode_frame(link, LINK_LAST, data, bytes);
}

void link_busy(link_state *link)
{
    encode_frame(link, LINK_BUSY, NULL, 0u);
}

/* Append the data of a frame to the message; returns what link_take returns. */
static int take_data(link_state *link, unsigned char flags, const unsigned char *data, size_t bytes)
{
    link->overflow = link->overflow || bytes > link->capacity - link->bytes;
    if (!link->overflow) {
        memcpy(link->message + link->bytes, data, bytes);
        link->bytes += bytes;
    }
    if (flags & LINK_LAST && !link->overflow) {
        return 1;
    }
    encode_frame(link, link->overflow && flags & LINK_LAST ? LINK_LAST | LINK_TOO_LONG : 0, NULL, 0u);
    return -1;
}

static int take_frame(link_state *link, const unsigned char *frame, size_t bytes)
{
    const unsigned char sequence = frame[0], flags = frame[1];
    if (flags & LINK_FIRST) {
        link->started = 1;
    } else if (!link->started) {
        link->sequence = sequence;
        encode_frame(link, LINK_LAST | LINK_NO_SESSION, NULL, 0u);
        return -1;
    } else if (sequence == link->sequence) {
        return -1; /* taken before: its answer was lost */
    } else if (sequence != (unsigned char)(link->sequence + 1u)) {
        return 0;
    }
    if (flags & LINK_FIRST || link->finished) {
        link->bytes = 0u;
        link->overflow = 0;
    }
    link->finished = flags & LINK_LAST;
    link->sequence = sequence;
    return take_data(link, flags, frame + HEAD, bytes - HEAD);
}

int link_take(link_state *link, unsigned char byte)
{
    if (byte) {
        if (link->coded_bytes < LINK_CODED) {
            link->coded[link->coded_bytes] = byte;
        }
        link->coded_bytes += link->coded_bytes <= LINK_CODED; /* one more than fit: too long, as in noise */
        return 0;
    }
    const size_t coded = link->coded_bytes;
    link->coded_bytes = 0u;
    const size_t bytes = coded && coded <= LINK_CODED ? link_decode(link->coded, coded) : 0u;
    return bytes ? take_frame(link, link->coded, bytes) : 0;
}
