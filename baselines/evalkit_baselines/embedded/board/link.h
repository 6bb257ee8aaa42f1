/* link.h - messages over a serial line that may lose or damage bytes: frames, checksums, and each message once.
 *
 * A frame is COBS(sequence, flags, data, CRC-32) and a zero byte; COBS leaves no zero in it, so that after any damage
 * the next zero begins a good frame. A zero before a frame ends what else was written to the line; empty frames are ignored.
 * The host sends a message as frames of at most LINK_DATA bytes, the last one with
 * LINK_LAST, and waits after each for a frame of the board with the same sequence: empty, or the answer to the message. What
 * is damaged is ignored; without an answer the host sends the frame again, and a frame that was already taken is answered
 * again without being taken twice. LINK_FIRST begins a session: the host sends it with the first frame. LINK_BUSY says that
 * the message is complete and the answer will follow: the host waits for it, and now and then asks with an empty frame.
 */
#ifndef LINK_H
#define LINK_H

#include <stddef.h>
#include <stdint.h>

#define LINK_DATA 512u
#define LINK_FRAME (LINK_DATA + 6u)               /* sequence, flags, data, checksum */
#define LINK_CODED (LINK_FRAME + LINK_FRAME / 254u + 2u) /* with COBS and the zero */

enum { LINK_LAST = 1, LINK_FIRST = 2, LINK_NO_SESSION = 4, LINK_TOO_LONG = 8, LINK_BUSY = 16 };

typedef struct {
    unsigned char *message; /* memory for a message of the host */
    size_t capacity, bytes; /* of message */
    unsigned char coded[LINK_CODED], answer[LINK_CODED];
    size_t coded_bytes, answer_bytes;
    int started, finished, overflow; /* a session has begun; the message is complete; it does not fit */
    unsigned char sequence; /* of the last frame taken */
} link_state;

/* Take a byte from the line. Returns 1 if a message is complete: write the frame of link_busy to the line, compute, and
 * answer with link_answer; what arrives meanwhile may be lost. Returns -1 if link->answer must be written to the line now
 * (answer_bytes of it), and 0 if nothing is to do. */
int link_take(link_state *link, unsigned char byte);

/* Encode that the message is complete and the answer will follow, into link->answer. */
void link_busy(link_state *link);

/* Encode the answer to the message, at most LINK_DATA bytes, into link->answer. */
void link_answer(link_state *link, const unsigned char *data, size_t bytes);

/* Decode a frame without its zero in place; returns its bytes without the checksum, 0 if it is damaged. */
size_t link_decode(unsigned char *coded, size_t bytes);

/* Encode bytes with COBS and add the zero; returns the bytes of `coded`, which must hold bytes + bytes / 254 + 2. */
size_t link_encode(const unsigned char *bytes_in, size_t bytes, unsigned char *coded);

/* CRC-32 as in zlib and Ethernet. */
uint32_t link_checksum(const unsigned char *bytes_in, size_t bytes);

#endif
