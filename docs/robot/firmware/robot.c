/* Firmware of the small robot for an ATmega328 at 16 MHz; packets as in wings/robot/packets.py.

   Interrupts count encoder ticks, stamp echoes and move bytes; all else runs in the main loop, which never waits.
   With -DFRAMED=1 packets have marker and CRC-16. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>
#include <util/atomic.h>
#include <util/crc16.h>
#include <util/delay.h>

#include "board.h"

#define BAUD 9600
#include <util/setbaud.h>

#ifndef FRAMED
#define FRAMED 0
#endif

/* ---- clock: timer 0 counts 4 us, an interrupt each ms ---- */

static volatile uint16_t clock_ms;

ISR(TIMER0_COMPA_vect) { clock_ms++; }

static uint16_t now_ms(void) {
    uint16_t ms;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { ms = clock_ms; }
    return ms;
}

/* Time in 4 us, with interrupts off; overflows after 262 ms. */
static uint16_t stamp(void) {
    uint16_t ms = clock_ms;
    uint8_t count = TCNT0;
    if ((TIFR0 & _BV(OCF0A)) && count < 125) ms++; /* the ms ended, its interrupt waits */
    return ms * 250U + count;
}

static void clock_begin(void) {
    TCCR0A = _BV(WGM01);
    OCR0A = 249;
    TIMSK0 = _BV(OCIE0A);
    TCCR0B = _BV(CS01) | _BV(CS00);
}

/* ---- encoders: both edges of channel A count ---- */

static volatile uint32_t left_count, right_count;

ISR(INT0_vect) {
    uint8_t pins = PIND;
    bool forward = !(pins & _BV(LEFT_A)) != !(pins & _BV(LEFT_B));
    left_count += forward ? 1 : -1;
}

ISR(INT1_vect) {
    uint8_t pins = PIND;
    bool forward = !(pins & _BV(RIGHT_A)) != !(pins & _BV(RIGHT_B));
    right_count += forward ? 1 : -1;
}

static void encoders_begin(void) {
    PORTD |= _BV(LEFT_A) | _BV(RIGHT_A) | _BV(LEFT_B) | _BV(RIGHT_B);
    EICRA = _BV(ISC00) | _BV(ISC10);
    EIFR = _BV(INTF0) | _BV(INTF1); /* edges before this are no ticks */
    EIMSK = _BV(INT0) | _BV(INT1);
}

/* ---- odometry ---- */

static const int16_t SINE[65] PROGMEM = { /* of a quarter turn, 2^14 */
    0, 402, 804, 1205, 1606, 2006, 2404, 2801, 3196, 3590, 3981, 4370, 4756,
    5139, 5520, 5897, 6270, 6639, 7005, 7366, 7723, 8076, 8423, 8765, 9102, 9434,
    9760, 10080, 10394, 10702, 11003, 11297, 11585, 11866, 12140, 12406, 12665, 12916, 13160,
    13395, 13623, 13842, 14053, 14256, 14449, 14635, 14811, 14978, 15137, 15286, 15426, 15557,
    15679, 15791, 15893, 15986, 16069, 16143, 16207, 16261, 16305, 16340, 16364, 16379, 16384,
};

/* Sine, 2^14, of an angle of which a turn has 2^16; interpolated, off by at most 1e-4. */
static int16_t sine(uint16_t angle) {
    uint16_t within = angle & 0x3FFF;
    if (angle & 0x4000) within = 0x4000 - within;
    uint8_t i = within >> 8;
    int16_t low = pgm_read_word(&SINE[i]);
    if (i < 64) low += (int32_t)((int16_t)pgm_read_word(&SINE[i + 1]) - low) * (within & 0xFF) >> 8;
    return angle & 0x8000 ? -low : low;
}

static int64_t x_sum, y_sum;  /* half ticks, 2^-14 */
static int32_t turned;        /* ticks that the right wheel is ahead of the left one */
static uint32_t left_before, right_before;

/* Heading of a number of ticks of difference; a turn, 2^32, has 2 pi x 250 mm / 0.2127 mm of them. */
static uint32_t heading_of(int32_t ticks) { return (uint32_t)ticks * 581611UL; }

/* Advance the odometry by the ticks since the last call, which are returned. */
static void odometry_step(int16_t *left, int16_t *right) {
    uint32_t l, r;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        l = left_count;
        r = right_count;
    }
    *left = (int16_t)(l - left_before);
    *right = (int16_t)(r - right_before);
    left_before = l;
    right_before = r;
    int16_t turn = *right - *left;
    int32_t half_turn = (int32_t)turn * (581611L / 2);
    uint16_t middle = (heading_of(turned) + (uint32_t)half_turn + 0x8000UL) >> 16;
    int32_t forward = *left + *right;
    x_sum += forward * sine(middle + 0x4000U);
    y_sum += forward * sine(middle);
    turned += turn;
}

/* The nearest whole number to value x factor / divisor, as int16: overflows. */
static int16_t scaled(int64_t value, int32_t factor, int64_t divisor) {
    int64_t doubled = 2 * value * factor + divisor, twice = 2 * divisor;
    int64_t whole = doubled / twice;
    if (doubled % twice < 0) whole--;
    return (int16_t)(uint16_t)whole;
}

/* ---- motors: PWM by timer 1 ---- */

static int32_t left_sum, right_sum; /* integral of the errors, parts of a tick */
static int32_t left_wanted, right_wanted; /* parts of a tick per step */
static uint16_t commanded; /* ms, time of the last command */
static bool driven;        /* a command came within WATCHDOG_MS */

static void motors_begin(void) {
    TCCR1A = _BV(COM1A1) | _BV(COM1B1) | _BV(WGM11); /* phase correct, 9 bits */
    TCCR1B = _BV(CS10);
    DDRB |= _BV(LEFT_PWM) | _BV(RIGHT_PWM);
    DDRD |= _BV(LEFT_DIRECTION) | _BV(RIGHT_DIRECTION);
}

static void set_duty(volatile uint16_t *compare, uint8_t direction, int16_t duty) {
    if (duty < 0)
        PORTD &= ~_BV(direction);
    else
        PORTD |= _BV(direction);
    *compare = duty < 0 ? -duty : duty;
}

/* Duty by the PI loop; the integral holds at the limit unless the error leads away from it, and is zero at rest. */
static int16_t loop_duty(int32_t wanted, int16_t ticks, int32_t *sum) {
    int32_t error = wanted - ticks * FINE;
    int32_t next = wanted ? *sum + error : 0;
    int32_t duty = GAIN * (error + next / INTEGRAL_PART) / FINE;
    int32_t limited = duty > FULL_DUTY ? FULL_DUTY : duty < -FULL_DUTY ? -FULL_DUTY : duty;
    if (!wanted || duty == limited || (duty > limited) != (error > 0)) *sum = next;
    return limited;
}

static void motors_step(int16_t left_ticks, int16_t right_ticks) {
    uint16_t silent = now_ms() - commanded;
    if (silent >= PATIENCE_MS) left_wanted = right_wanted = 0;
    if (silent >= WATCHDOG_MS) driven = false; /* commanded may overflow from now on */
    int16_t left = loop_duty(left_wanted, left_ticks, &left_sum);
    int16_t right = loop_duty(right_wanted, right_ticks, &right_sum);
    set_duty(&OCR1A, LEFT_DIRECTION, driven ? left : 0);
    set_duty(&OCR1B, RIGHT_DIRECTION, driven ? right : 0);
}

/* Parts of a tick per step for a rim's speed [um/s], limited. */
static int32_t wanted_of(int32_t speed) {
    if (speed > FASTEST_UM_S) speed = FASTEST_UM_S;
    if (speed < -FASTEST_UM_S) speed = -FASTEST_UM_S;
    return speed * FINE / (TICK_NM / STEP_MS);
}

static void obey(int16_t speed, int16_t turn) {
    int32_t ahead = 1000L * speed, aside = turn * (WHEEL_BASE_MM / 2);
    left_wanted = wanted_of(ahead - aside);
    right_wanted = wanted_of(ahead + aside);
    commanded = now_ms();
    driven = true;
}

/* ---- sonars: one after the other; the pulse on the common echo line is as long as the sound was on its way ---- */

static volatile uint16_t echo_began, echo_width; /* 4 us */
static volatile bool echo_rose, echo_fell;
static int16_t distances[SONAR_COUNT]; /* mm */
static uint8_t sonar = SONAR_COUNT - 1;
static uint16_t slot_began;

ISR(PCINT0_vect) {
    uint16_t now = stamp();
    if (PINB & _BV(ECHO)) {
        echo_began = now;
        echo_rose = true;
    } else if (echo_rose && !echo_fell) {
        echo_width = now - echo_began;
        echo_fell = true;
    }
}

static void sonars_begin(void) {
    for (uint8_t i = 0; i < SONAR_COUNT; i++) {
        distances[i] = TIMEOUT_MM;
        if (!(SONARS & _BV(i))) continue;
        if (i < PORT_C_SONARS)
            DDRC |= _BV(i);
        else
            DDRB |= _BV(FIRST_PORT_B_TRIGGER + i - PORT_C_SONARS);
    }
    PCMSK0 = _BV(PCINT0);
    PCICR = _BV(PCIE0);
}

static void trigger(uint8_t i) {
    volatile uint8_t *port = i < PORT_C_SONARS ? &PORTC : &PORTB;
    uint8_t pin = _BV(i < PORT_C_SONARS ? i : FIRST_PORT_B_TRIGGER + i - PORT_C_SONARS);
    *port |= pin;
    _delay_us(10);
    *port &= ~pin;
}

static void sonars_step(void) {
    uint16_t taken = now_ms() - slot_began;
    bool high = PINB & _BV(ECHO);
    if (!SONARS || taken < SLOT_MS || (high && taken < STUCK_MS)) return;
    if (SONARS & _BV(sonar)) {
        uint32_t mm = echo_fell ? echo_width * 20UL / 29 : TIMEOUT_MM; /* 5.8 us per mm */
        distances[sonar] = mm < TIMEOUT_MM ? mm : TIMEOUT_MM;
    }
    do sonar = (sonar + 1) % SONAR_COUNT;
    while (!(SONARS & _BV(sonar)));
    slot_began = now_ms();
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { echo_rose = echo_fell = false; }
    trigger(sonar);
}

/* ---- serial line ---- */

#define COMMAND_BYTES 4
#define ANSWER_BYTES (2 * (SONAR_COUNT + 3))
#define FRAME_BYTES (FRAMED ? 4 : 0)
#define MARKER_0 0xA5
#define MARKER_1 0x5A

static volatile uint8_t received[16], received_head; /* a ring; the main loop empties it each ms */
static uint8_t received_tail;
static uint8_t sending[ANSWER_BYTES + FRAME_BYTES];
static volatile uint8_t sent = sizeof sending;

ISR(USART_RX_vect) {
    received[received_head % sizeof received] = UDR0;
    received_head++;
}

ISR(USART_UDRE_vect) {
    UDR0 = sending[sent++];
    if (sent == sizeof sending) UCSR0B &= ~_BV(UDRIE0);
}

static void line_begin(void) {
    UBRR0 = UBRR_VALUE;
#if USE_2X
    UCSR0A = _BV(U2X0);
#endif
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

static uint8_t *put(uint8_t *to, int16_t value) {
    *to++ = value & 0xFF;
    *to++ = (uint16_t)value >> 8;
    return to;
}

static int16_t get(const uint8_t *from) { return from[0] | (uint16_t)from[1] << 8; }

#if FRAMED
/* CRC-16, polynomial 0x1021, start 0xFFFF, not reflected. */
static uint16_t checksum(const uint8_t *data, uint8_t size) {
    uint16_t crc = 0xFFFF;
    while (size--) crc = _crc_xmodem_update(crc, *data++);
    return crc;
}
#endif

/* Send the distances and the odometry; a command that comes while an answer is being sent gets none. */
static void answer(void) {
    if (sent < sizeof sending) return;
    uint8_t *to = sending;
#if FRAMED
    *to++ = MARKER_0;
    *to++ = MARKER_1;
#endif
    for (uint8_t i = 0; i < SONAR_COUNT; i++) to = put(to, distances[i]);
    to = put(to, scaled(x_sum, TICK_NM / 2, 1000000LL << 14));
    to = put(to, scaled(y_sum, TICK_NM / 2, 1000000LL << 14));
    to = put(to, scaled(turned, TICK_NM, 1000LL * WHEEL_BASE_MM));
#if FRAMED
    put(to, checksum(sending + 2, ANSWER_BYTES));
#endif
    sent = 0;
    UCSR0B |= _BV(UDRIE0);
}

static uint8_t pending[COMMAND_BYTES + FRAME_BYTES], filled;
static uint16_t came; /* ms, time of the last byte */

/* Whether a byte completes a command; a frame is sought at each byte. */
static bool completes(uint8_t byte) {
    if ((uint16_t)(now_ms() - came) > COMMAND_PAUSE_MS) filled = 0;
    came = now_ms();
    if (filled == sizeof pending) {
        memmove(pending, pending + 1, sizeof pending - 1);
        filled--;
    }
    pending[filled++] = byte;
    if (filled < sizeof pending) return false;
#if FRAMED
    const uint8_t *content = pending + 2;
    if (pending[0] != MARKER_0 || pending[1] != MARKER_1) return false;
    if (checksum(content, COMMAND_BYTES) != (uint16_t)get(content + COMMAND_BYTES)) return false;
#endif
    filled = 0;
    return true;
}

static void line_step(void) {
    while (received_tail != received_head) {
        if (!completes(received[received_tail++ % sizeof received])) continue;
        const uint8_t *content = pending + FRAME_BYTES / 2;
        obey(get(content), get(content + 2));
        answer();
    }
}

int main(void) {
    MCUSR = 0;
    wdt_enable(WDTO_250MS); /* a main loop that hangs resets the board, and its motors are off */
    clock_begin();
    encoders_begin();
    motors_begin();
    sonars_begin();
    line_begin();
    set_sleep_mode(SLEEP_MODE_IDLE);
    sei();
    uint16_t stepped = now_ms();
    for (;;) {
        wdt_reset();
        line_step();
        sonars_step();
        if ((uint16_t)(now_ms() - stepped) >= STEP_MS) {
            stepped += STEP_MS;
            int16_t left, right;
            odometry_step(&left, &right);
            motors_step(left, right);
        }
        sleep_mode(); /* until an interrupt, at the latest that of the next ms */
    }
}
