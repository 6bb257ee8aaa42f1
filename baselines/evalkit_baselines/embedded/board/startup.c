/* Start of a Cortex-M4F, with the names of CMSIS: vectors, floating-point unit, memory. For a real board use its
 * vendor's start-up file and system_*.c, and keep only port.h. */
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define COPROCESSORS (*(volatile uint32_t *)0xE000ED88u) /* SCB->CPACR */
#define SYS_EXIT 0x18u
#define RUN_TIME_ERROR 0x20023u

extern uint32_t __StackTop;
extern unsigned char __etext, __data_start__, __data_end__, __bss_start__, __bss_end__;

/* With BOARD_SEMIHOSTING newlib's start reads the command line from the emulator, or debugger, and calls main. */
#ifdef BOARD_SEMIHOSTING
extern void _start(void);
#define START _start
#else
extern int main(void);
#define START main
#endif

void Reset_Handler(void)
{
    COPROCESSORS |= 0xFu << 20;
    __asm volatile("dsb\n\tisb");
    memcpy(&__data_start__, &__etext, (size_t)(&__data_end__ - &__data_start__));
    memset(&__bss_start__, 0, (size_t)(&__bss_end__ - &__bss_start__));
    START();
    for (;;) {
    }
}

/* A fault ends an emulation; on a board without a debugger it stops here. */
void Default_Handler(void)
{
#ifdef BOARD_SEMIHOSTING
    __asm volatile("mov r0, %0\n\tmov r1, %1\n\tbkpt 0xab" : : "r"(SYS_EXIT), "r"(RUN_TIME_ERROR) : "r0", "r1");
#endif
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static const uintptr_t vectors[16] = {
    (uintptr_t)&__StackTop,      (uintptr_t)Reset_Handler,   (uintptr_t)Default_Handler, (uintptr_t)Default_Handler,
    (uintptr_t)Default_Handler,  (uintptr_t)Default_Handler, (uintptr_t)Default_Handler, 0u, 0u, 0u, 0u,
    (uintptr_t)Default_Handler,  (uintptr_t)Default_Handler, 0u, (uintptr_t)Default_Handler, (uintptr_t)Default_Handler,
};

#ifdef BOARD_SEMIHOSTING
/* Memory of malloc for programs of a computer that run on the board; the firmware has none. */
void *_sbrk(ptrdiff_t bytes);
void *_sbrk(ptrdiff_t bytes)
{
    extern unsigned char __HeapBase, __HeapLimit;
    static unsigned char *end = &__HeapBase;
    unsigned char *const begin = end;
    if (bytes > &__HeapLimit - end) {
        return (void *)-1;
    }
    end += bytes;
    return begin;
}
#endif
