/* port.h - what a board must provide: a serial line and a clock. mps2.c is the emulated board, host.c this computer. */
#ifndef PORT_H
#define PORT_H

#include <stdint.h>

void port_init(void);

/* Wait for a byte of the line; -1 if there is none any more (only on a computer). */
int port_read(void);

void port_write(unsigned char byte);

/* A clock in nanoseconds; only differences count. It must not wrap while a message is answered: 32 bits of nanoseconds do
 * after 4.3 s. In an emulator that counts instructions (-icount shift=0) it is their number, in steps of 40. */
uint64_t port_clock_ns(void);

#endif
