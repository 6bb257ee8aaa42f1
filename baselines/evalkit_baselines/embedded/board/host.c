/* The firmware as a program of this computer, for tests: its serial line is standard input and output. */
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <time.h>

#include "port.h"

void port_init(void)
{
}

int port_read(void)
{
    fflush(stdout);
    return getchar();
}

void port_write(unsigned char byte)
{
    putchar(byte);
}

uint64_t port_clock_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}
