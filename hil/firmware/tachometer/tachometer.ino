/* Tachometer of the propeller rig, for an Arduino Uno (ATmega328P at 16 MHz), with a relay as watchdog of the Pi.
 *
 * Wiring: HW201 sensor, output to D2 (falls when the tape passes), 5 V, GND. D4 drives the relay in the ESC's supply: high
 * closes it. A pull-down of 10 kOhm from D4 to ground keeps it open while the board has no supply, resets or boots. USB to the
 * Pi, 500 000 baud.
 * It sends only answers to requests, and one greeting after a reset. Built by the Arduino IDE without changes, or by avr-gcc
 * alone:  avr-g++ -mmcu=atmega328p -DF_CPU=16000000UL -Os -x c++ tachometer.ino -o tachometer.elf
 *
 * It uses registers, not the core's functions: Serial would block in write, micros() shares its timer, and attachInterrupt adds
 * a microsecond or two of call to every pass.
 */
#include <avr/interrupt.h>
#include <avr/io.h>

#include "tachometer.h"

#define RELAY _BV(PORTD4)
#define HEARD 64u /* a power of two; size of the buffer of received bytes */

static Rotor rotor;
static Relay relay;
static volatile uint16_t overflows;
static volatile uint8_t heard[HEARD], heard_in;
static uint8_t heard_out;
static Reader reader;
static uint8_t said[LONGEST], said_end, said_at;

/* Call it with interrupts off only, so that no overflow occurs between the two reads. */
static inline uint32_t now_locked(void) {
    uint16_t count = TCNT1;
    return ticks(overflows, count, TIFR1 & _BV(TOV1));
}

ISR(TIMER1_OVF_vect) { overflows++; }

ISR(INT0_vect) { rotor_edge(&rotor, now_locked()); }

ISR(USART_RX_vect) {
    uint8_t next = (heard_in + 1u) % HEARD;
    uint8_t byte = UDR0;
    if (next != heard_out) {
        heard[heard_in] = byte;
        heard_in = next;
    }
}

/* The relay's deadline, in a timer interrupt: it opens even if loop() hangs. */
ISR(TIMER1_COMPB_vect) {
    relay_watch(&relay, now_locked() + 1u);
    if (!relay.closed) PORTD &= ~RELAY;
}

void setup() {
    cli();
    PORTD &= ~RELAY;
    DDRD |= RELAY;
    TIMSK0 = 0; /* the Arduino core's millis(), not used here: its interrupt would delay the mark's */

    TCCR1A = 0;
    TCCR1B = _BV(CS11) | _BV(CS10); /* 16 MHz / 64: 4 us */
    TIMSK1 = _BV(TOIE1) | _BV(OCIE1B);
    TIFR1 = _BV(TOV1) | _BV(OCF1B);

    DDRD &= ~_BV(DDD2);
    PORTD |= _BV(PORTD2); /* pull-up: with a loose wire no mark is seen */
    EICRA = _BV(ISC01);   /* falling edge */
    EIFR = _BV(INTF0);
    EIMSK = _BV(INT0);

    UCSR0A = _BV(U2X0);
    UBRR0 = F_CPU / 8 / BAUD - 1; /* 3, without a remainder */
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
    sei();

    said_end = write_hello(said, 0);
}

/* Writes the answer; all its numbers are of one moment, without a pass in between. */
static uint8_t answer(uint8_t sequence) {
    cli();
    uint32_t now = now_locked();
    Rotor seen = rotor;
    uint8_t flags = relay_flags(&relay);
    sei();
    rotor_watch(&seen, now);
    return write_answer(said, sequence, &seen, flags, now);
}

/* Handles a valid request. */
static void heard_from(Request request) {
    cli();
    uint32_t now = now_locked();
    if (request.type == ARM && request.word) relay_arm(&relay, now);
    if (request.type == ASK_ANSWER) relay_heard(&relay, now);
    if (request.type == STOP) relay_stop(&relay);
    OCR1B = (uint16_t)(relay.heard + SILENCE_TICKS);
    if (relay.closed) PORTD |= RELAY;
    else PORTD &= ~RELAY;
    sei();
}

void loop() {
    cli();
    uint32_t now = now_locked();
    rotor_watch(&rotor, now);
    relay_watch(&relay, now);
    if (!relay.closed) PORTD &= ~RELAY;
    sei();

    if (said_at < said_end) {
        if (UCSR0A & _BV(UDRE0)) UDR0 = said[said_at++];
    } else if (heard_out != heard_in) {
        Request request = reader_take(&reader, heard[heard_out]);
        heard_out = (heard_out + 1u) % HEARD;
        said_at = said_end = 0;
        if (request.type) heard_from(request);
        if (request.type == ASK_ANSWER) said_end = answer(request.sequence);
        if (request.type == ASK_HELLO) said_end = write_hello(said, request.sequence);
    }
}

#ifndef ARDUINO
int main() {
    setup();
    for (;;) loop();
}
#endif
