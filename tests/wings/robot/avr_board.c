/* The board of docs/robot/firmware in simavr, in the time of its own clock, with encoders, sonars and a serial line.

   avr_board ROBOT.ELF

   Standard input, a line per slice of time: its length [us], ticks per second of the left and the right wheel, eight
   echo widths [us] (0: none), and the bytes to send, hexadecimal, or "-". Standard output, a line for each: duty of the
   left and the right motor [1/1000] at the end of the slice, and the bytes that came, or "-". */
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

#define TICK_CYCLES 160 /* 10 us */
#define BYTE_CYCLES 16667
#define ECHO_AFTER_US 450 /* the sonar sends its eight periods */
#define BYTES 4096
#define FULL_DUTY 511
enum { PORTD = 0x2B, TCCR1A = 0x80, OCR1A = 0x88, OCR1B = 0x8A };

static avr_t *avr;
static avr_irq_t *line, *echo, *channel[2][2];
static double rate[2], phase[2]; /* ticks per s; quarters of a period of channel A, two to a tick */
static long quarter[2];
static unsigned width[8];
static unsigned char to_board[BYTES], from_board[BYTES];
static unsigned to_count, to_next, from_count;
static avr_cycle_count_t next_byte;

/* The encoders' levels; they are stronger than the pull-ups, which simavr applies at each write to the port. */
static void show_encoders(void) {
    avr_ioport_external_t held = {.name = 'D', .mask = 0x3C};
    for (int side = 0; side < 2; side++)
        held.value |= (((quarter[side] + 1) >> 1 & 1) << (2 + side)) | ((quarter[side] >> 1 & 1) << (4 + side));
    avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('D'), &held);
    for (int side = 0; side < 2; side++) {
        avr_raise_irq(channel[side][0], held.value >> (2 + side) & 1);
        avr_raise_irq(channel[side][1], held.value >> (4 + side) & 1);
    }
}

static avr_cycle_count_t tick(avr_t *a, avr_cycle_count_t when, void *param) {
    (void)a, (void)param;
    for (int side = 0; side < 2; side++) {
        phase[side] += 2.0 * rate[side] * TICK_CYCLES / 16e6;
        while (phase[side] >= 1.0 || phase[side] <= -1.0) {
            int step = phase[side] > 0.0 ? 1 : -1;
            phase[side] -= step;
            quarter[side] += step;
            show_encoders();
        }
    }
    if (to_next < to_count && when >= next_byte) {
        avr_raise_irq(line, to_board[to_next++]);
        next_byte = when + BYTE_CYCLES;
    }
    return when + TICK_CYCLES;
}

static avr_cycle_count_t falls(avr_t *a, avr_cycle_count_t when, void *param) {
    (void)a, (void)when, (void)param;
    avr_raise_irq(echo, 0);
    return 0;
}

static avr_cycle_count_t rises(avr_t *a, avr_cycle_count_t when, void *param) {
    (void)a, (void)when;
    avr_raise_irq(echo, 1);
    avr_cycle_timer_register_usec(avr, (uint32_t)(uintptr_t)param, falls, NULL);
    return 0;
}

static void triggered(avr_irq_t *irq, uint32_t value, void *param) {
    unsigned us = width[(uintptr_t)param];
    (void)irq;
    if (!value && us) avr_cycle_timer_register_usec(avr, ECHO_AFTER_US, rises, (void *)(uintptr_t)us);
}

static void sent(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    if (from_count < BYTES) from_board[from_count++] = value;
}

static void quiet(avr_t *a, const int level, const char *format, va_list values) {
    (void)a;
    if (level <= LOG_ERROR) vfprintf(stderr, format, values);
}

static void no_sleep(avr_t *a, avr_cycle_count_t cycles) { (void)a, (void)cycles; }

static int word(int at) { return avr->data[at] | avr->data[at + 1] << 8; }

/* 0 too where the pin is not connected to the timer. */
static int duty(int compare, int connected, int direction) {
    if (!(avr->data[TCCR1A] & connected)) return 0;
    int size = 1000 * word(compare) / FULL_DUTY;
    return avr->data[PORTD] & direction ? size : -size;
}

static avr_irq_t *pin(char port, int number) { return avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(port), number); }

int main(int count, char **arguments) {
    elf_firmware_t firmware = {0};
    avr_global_logger_set(quiet);
    if (count != 2 || elf_read_firmware(arguments[1], &firmware)) return 2;
    avr = avr_make_mcu_by_name("atmega328p");
    avr_init(avr);
    firmware.frequency = 16000000;
    avr_load_firmware(avr, &firmware);
    avr->sleep = no_sleep;
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    line = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), sent, NULL);
    echo = pin('B', 0);
    for (int side = 0; side < 2; side++) {
        channel[side][0] = pin('D', 2 + side);
        channel[side][1] = pin('D', 4 + side);
    }
    show_encoders();
    avr_raise_irq(echo, 0);
    for (int i = 0; i < 8; i++)
        avr_irq_register_notify(i < 6 ? pin('C', i) : pin('B', i - 3), triggered, (void *)(uintptr_t)i);
    avr_cycle_timer_register(avr, TICK_CYCLES, tick, NULL);

    unsigned long us;
    static char hex[2 * BYTES + 1];
    avr_cycle_count_t until = 0;
    while (scanf("%lu %lf %lf", &us, &rate[0], &rate[1]) == 3) {
        for (int i = 0; i < 8; i++)
            if (scanf("%u", &width[i]) != 1) return 2;
        if (scanf("%8192s", hex) != 1) return 2;
        if (to_next == to_count) to_next = to_count = 0;
        for (char *at = hex; at[0] != '-' && at[0] && to_count < BYTES; at += 2) {
            unsigned byte;
            if (sscanf(at, "%2x", &byte) != 1) return 2;
            to_board[to_count++] = byte;
        }
        from_count = 0;
        for (until += 16 * us; avr->cycle < until;) {
            int state = avr_run(avr);
            if (state == cpu_Done || state == cpu_Crashed) return 3;
        }
        printf("%d %d ", duty(OCR1A, 0x80, 1 << 6), duty(OCR1B, 0x20, 1 << 7));
        for (unsigned i = 0; i < from_count; i++) printf("%02x", from_board[i]);
        puts(from_count ? "" : "-");
        fflush(stdout);
    }
    return 0;
}
