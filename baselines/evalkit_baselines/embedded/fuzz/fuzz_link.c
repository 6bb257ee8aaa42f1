/* Arbitrary bytes on a serial line, among frames that a host may send: no message exceeds its memory, every answer is a
 * frame with the sequence of the frame that was taken, and frames in their order give the message to the byte. */
#include "input.h"

#include "../board/link.h"

/* Take the link's answer apart; its flags. */
static unsigned char check_answer(const link_state *link, const unsigned char *data, size_t count)
{
    unsigned char coded[LINK_CODED];
    HOLDS(link->answer_bytes > 1u && link->answer_bytes <= LINK_CODED);
    HOLDS(memchr(link->answer, 0, link->answer_bytes) == link->answer + link->answer_bytes - 1u);
    memcpy(coded, link->answer, link->answer_bytes - 1u);
    HOLDS(link_decode(coded, link->answer_bytes - 1u) == 2u + count);
    HOLDS(coded[0] == link->sequence);
    HOLDS(!count || memcmp(coded + 2, data, count) == 0);
    return coded[1];
}

/* Take bytes as they come; 1 if the last one completes a message. */
static int take_bytes(link_state *link, const unsigned char *bytes, size_t count)
{
    int taken = 0;
    for (size_t k = 0; k < count; k++) {
        taken = link_take(link, bytes[k]);
        HOLDS(taken >= -1 && taken <= 1 && link->bytes <= link->capacity);
        HOLDS(taken == 0 || bytes[k] == 0u);
        if (taken > 0) {
            HOLDS(link->started && !link->overflow);
            link_busy(link);
            HOLDS(check_answer(link, NULL, 0u) == LINK_BUSY);
            link_answer(link, link->message, link->bytes < LINK_DATA ? link->bytes : LINK_DATA);
            check_answer(link, link->message, link->bytes < LINK_DATA ? link->bytes : LINK_DATA);
        }
    }
    return taken;
}

/* Send a frame of `count` bytes. */
static int send(link_state *link, unsigned char sequence, unsigned char flags, const unsigned char *data, size_t count)
{
    unsigned char frame[LINK_FRAME], coded[LINK_CODED + 1u] = {0u};
    frame[0] = sequence;
    frame[1] = flags;
    memcpy(frame + 2, data, count);
    const uint32_t sum = link_checksum(frame, 2u + count);
    for (size_t k = 0; k < 4u; k++) {
        frame[2u + count + k] = (unsigned char)(sum >> 8u * k);
    }
    const size_t bytes = link_encode(frame, count + 6u, coded + 1);
    HOLDS(bytes <= LINK_CODED && memchr(coded + 1, 0, bytes) == coded + bytes);
    return take_bytes(link, coded, bytes + 1u); /* a zero first ends noise */
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    ek_input input = {bytes, size};
    static link_state link;
    unsigned char data[LINK_DATA], sequence = take_byte(&input);
    memset(&link, 0, sizeof link);
    link.capacity = take_byte(&input) * 8u;
    link.message = (unsigned char *)malloc(link.capacity ? link.capacity : 1u);
    unsigned char *const sent = (unsigned char *)malloc(2u * LINK_DATA);
    HOLDS(link.message != NULL && sent != NULL);
    while (input.left) {
        const uint8_t kind = take_byte(&input);
        const size_t count = take_byte(&input) * 2u % (LINK_DATA + 1u);
        take(&input, data, count);
        if (kind < 96u) {
            take_bytes(&link, data, count);
        } else if (kind < 192u) { /* any flags and sequence */
            send(&link, take_byte(&input), kind, data, count);
        } else { /* a message of two frames, the first one twice if the line lost its answer */
            take_bytes(&link, (const unsigned char *)"", 1u); /* the noise before may be a frame, with its checksum */
            const unsigned char first = link.started ? 0 : LINK_FIRST;
            sequence = link.started ? (unsigned char)(link.sequence + 1u) : sequence;
            link.finished = 1; /* the message before is complete */
            const int fits = 2u * count <= link.capacity;
            HOLDS(send(&link, sequence, first, data, count) == -1);
            HOLDS(!(kind & 1u) || send(&link, sequence, first, data, count) == -1);
            HOLDS(send(&link, (unsigned char)(sequence + 1u), LINK_LAST, data, count) == (fits ? 1 : -1));
            memcpy(sent, data, count);
            memcpy(sent + count, data, count);
            HOLDS(!fits || (link.bytes == 2u * count && memcmp(link.message, sent, 2u * count) == 0));
            HOLDS(fits || check_answer(&link, NULL, 0u) == (LINK_LAST | LINK_TOO_LONG));
        }
    }
    free(link.message);
    free(sent);
    return 0;
}
