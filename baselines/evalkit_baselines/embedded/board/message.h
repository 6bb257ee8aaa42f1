/* message.h - the numbers of a message and of its answer: without gaps, little-endian. A processor with another order of bytes
 * needs another take_reals. */
#ifndef MESSAGE_H
#define MESSAGE_H

#include <stddef.h>
#include <stdint.h>

#include "ek/se2.h"
#include "link.h"

/* A message that is read from its begin to its end; `short_by` counts bytes that were not there. */
typedef struct {
    const unsigned char *from;
    size_t left, short_by;
} reader;

typedef struct {
    unsigned char bytes[LINK_DATA];
    size_t count;
} writer;

/* Take a whole number of so many bytes. */
uint64_t take_unsigned(reader *in, size_t bytes);

double take_double(reader *in);

/* Take a whole number; -1, which every check refuses, for what is none of 31 bits. */
int32_t take_count(reader *in);

ek_pose take_pose(reader *in);

/* Copy reals; the processor is little-endian too. */
void take_reals(reader *in, ek_real *values, size_t count);

/* Put a whole number of so many bytes. Like put_double and put_pose, it needs the room of its bytes. */
void put_unsigned(writer *out, uint64_t value, size_t bytes);

void put_double(writer *out, double value);

void put_pose(writer *out, ek_pose pose);

/* Put a text, or as much of it as there is room for. */
void put_text(writer *out, const char *text);

/* Put a number as text. */
void put_number(writer *out, size_t number);

#endif
