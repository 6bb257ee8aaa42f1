/* The emulated board: MPS2 with AN386 (Cortex-M4F, 25 MHz), its first UART and a timer. */
#include "port.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define UART 0x40004000u
#define UART_DATA REGISTER(UART)
#define UART_STATE REGISTER(UART + 0x04u)
#define UART_CONTROL REGISTER(UART + 0x08u)
#define UART_INTERRUPT REGISTER(UART + 0x0cu)
#define UART_DIVIDER REGISTER(UART + 0x10u)
#define TIMER 0x40000000u
#define TIMER_CONTROL REGISTER(TIMER)
#define TIMER_VALUE REGISTER(TIMER + 0x04u)
#define TIMER_RELOAD REGISTER(TIMER + 0x08u)
#define TICK_NS 40u
#define NVIC_ENABLE REGISTER(0xE000E100u)
#define NVIC_CLEAR REGISTER(0xE000E280u)
#define RECEIVED 2u /* of UART_STATE and UART_INTERRUPT; interrupt 0 */

void port_init(void)
{
    UART_DIVIDER = 25000000u / 115200u;
    UART_CONTROL = 11u; /* send, receive, interrupt when received */
    __asm volatile("cpsid i"); /* interrupts only wake the processor: there is no handler */
    NVIC_ENABLE = 1u;
    TIMER_RELOAD = 0xffffffffu;
    TIMER_VALUE = 0xffffffffu;
    TIMER_CONTROL = 1u;
}

int port_read(void)
{
    while (!(UART_STATE & RECEIVED)) {
        __asm volatile("wfi");
    }
    UART_INTERRUPT = RECEIVED;
    NVIC_CLEAR = 1u;
    return (int)(UART_DATA & 0xffu);
}

void port_write(unsigned char byte)
{
    while (UART_STATE & 1u) {
    }
    UART_DATA = byte;
}

/* The timer has 32 bits: right where two calls are less than 172 s apart. */
uint64_t port_clock_ns(void)
{
    static uint64_t ticks;
    ticks += 0xffffffffu - TIMER_VALUE - (uint32_t)ticks;
    return ticks * TICK_NS;
}
