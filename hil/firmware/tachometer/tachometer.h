/* The tachometer's protocol and its timing of the mark's passes, in plain C that does not depend on the board, so that tests
 * compile it on the host, too. hil/devices/frames.py defines the same frames; both must agree.
 *
 * Times are ticks of 4 us on a counter of 32 bits that wraps after 4 h 46 min; differences are right across the wrap.
 */
#ifndef TACHOMETER_H
#define TACHOMETER_H

#include <stdint.h>
#include <string.h>

#define BAUD 500000UL
#define TICK_US 4u
#define REJECT_TICKS 1250u /* edges closer than 5 ms are no marks: 12 000 rpm */
#define STALL_TICKS 50000u /* 200 ms without a mark: below 300 rpm counts as standstill */
#define SILENCE_TICKS 25000u /* 100 ms without a request: the relay opens. 25 ticks of the loop */

#define VERSION 2u
#define SYNC 0x7Eu
#define OVERHEAD 6u /* sync, length, type, sequence, CRC */
#define ASK_HELLO 0x96u
#define ASK_ANSWER 0x69u
#define ARM 0xA5u
#define STOP 0x5Au
#define HELLO 0x3Cu
#define ANSWER 0xC3u
#define HELLO_LENGTH 6u
#define ANSWER_LENGTH 14u
#define LONGEST (ANSWER_LENGTH + OVERHEAD)
#define WORD "SPIN" /* ARM's payload: no other frame and no noise closes the relay */
#define WORD_LENGTH 4u

#define STALLED 0x01u
#define MEASURED 0x02u
#define CLOSED 0x04u
#define SILENT 0x08u

/* CRC-16/IBM-3740: polynomial 0x1021, start 0xFFFF, not reflected, not inverted. */
static inline uint16_t crc16_next(uint16_t crc, uint8_t byte) {
    uint8_t x = (uint8_t)((crc >> 8) ^ byte);
    x ^= (uint8_t)(x >> 4);
    return (uint16_t)((crc << 8) ^ ((uint16_t)x << 12) ^ ((uint16_t)x << 5) ^ x);
}

static inline uint16_t crc16(const uint8_t *data, uint8_t count) {
    uint16_t crc = 0xFFFFu;
    while (count--) crc = crc16_next(crc, *data++);
    return crc;
}

/* The mark's passes, as the interrupt sees them. All zero: none yet. */
typedef struct {
    uint32_t pulses; /* accepted since reset */
    uint32_t last;   /* time of the last one */
    uint16_t period; /* of the last whole revolution; 0: none since the last stall */
    uint8_t turning; /* 0 after a stall: `last` is then invalid */
    uint8_t rejected;
} Rotor;

/* A 16-bit timer's count and its overflows as one time. `pending`: an overflow is not counted yet. Then a small count belongs
 * to the new round, and a large one was read just before the overflow. */
static inline uint32_t ticks(uint16_t overflows, uint16_t count, uint8_t pending) {
    if (pending && count < 0x8000u) overflows++;
    return (uint32_t)overflows << 16 | count;
}

/* Processes a falling edge of the sensor's output at time `now`. */
static inline void rotor_edge(Rotor *rotor, uint32_t now) {
    uint32_t since = now - rotor->last;
    if (rotor->turning && since < REJECT_TICKS) {
        rotor->rejected++;
        return;
    }
    rotor->period = rotor->turning && since <= STALL_TICKS ? (uint16_t)since : 0u;
    rotor->turning = 1;
    rotor->last = now;
    rotor->pulses++;
}

/* Notes a stall. Call it often, at least once in 4 h; `now` must not be older than the last edge. */
static inline void rotor_watch(Rotor *rotor, uint32_t now) {
    if (rotor->turning && now - rotor->last > STALL_TICKS) {
        rotor->turning = 0;
        rotor->period = 0;
    }
}

/* The relay in the ESC's supply: closed by the word, kept closed by requests. All zero: open. */
typedef struct {
    uint32_t heard; /* time of the last request */
    uint8_t closed;
    uint8_t silent; /* it opened because no request came; until it is armed anew */
} Relay;

static inline void relay_arm(Relay *relay, uint32_t now) {
    relay->heard = now;
    relay->closed = 1;
    relay->silent = 0;
}

static inline void relay_heard(Relay *relay, uint32_t now) { relay->heard = now; }

static inline void relay_stop(Relay *relay) { relay->closed = 0; }

/* Opens the relay when requests have stopped. Call it often; `now` must not be older than the last request. */
static inline void relay_watch(Relay *relay, uint32_t now) {
    if (relay->closed && now - relay->heard > SILENCE_TICKS) {
        relay->closed = 0;
        relay->silent = 1;
    }
}

static inline uint8_t relay_flags(const Relay *relay) {
    return (uint8_t)((relay->closed ? CLOSED : 0u) | (relay->silent ? SILENT : 0u));
}

static inline uint8_t *put16(uint8_t *at, uint16_t value) {
    *at++ = (uint8_t)value;
    *at++ = (uint8_t)(value >> 8);
    return at;
}

static inline uint8_t *put32(uint8_t *at, uint32_t value) {
    return put16(put16(at, (uint16_t)value), (uint16_t)(value >> 16));
}

/* Completes a frame whose payload ends at `end`; returns its number of bytes. */
static inline uint8_t frame_close(uint8_t *frame, uint8_t *end, uint8_t type, uint8_t sequence) {
    frame[0] = SYNC;
    frame[1] = (uint8_t)(end - frame - 4);
    frame[2] = type;
    frame[3] = sequence;
    end = put16(end, crc16(frame + 1, (uint8_t)(end - frame - 1)));
    return (uint8_t)(end - frame);
}

/* Both write at most LONGEST bytes to `frame` and return how many. */
static inline uint8_t write_hello(uint8_t *frame, uint8_t sequence) {
    uint8_t *at = frame + 4;
    *at++ = VERSION;
    *at++ = TICK_US;
    at = put16(at, REJECT_TICKS);
    at = put16(at, STALL_TICKS);
    return frame_close(frame, at, HELLO, sequence);
}

static inline uint8_t write_answer(uint8_t *frame, uint8_t sequence, const Rotor *rotor, uint8_t relay, uint32_t now) {
    uint8_t *at = put32(put32(frame + 4, rotor->pulses), rotor->last);
    at = put16(at, rotor->period);
    at = put16(at, rotor->turning ? (uint16_t)(now - rotor->last) : 0xFFFFu); /* turning: no more than STALL_TICKS */
    *at++ = (uint8_t)((rotor->turning ? 0u : STALLED) | (rotor->period ? MEASURED : 0u) | relay);
    *at++ = rotor->rejected;
    return frame_close(frame, at, ANSWER, sequence);
}

/* Finds requests in the host's bytes. Only ARM has a payload, the word. */
typedef struct {
    uint8_t buffer[OVERHEAD + WORD_LENGTH];
    uint8_t filled;
} Reader;

typedef struct {
    uint8_t type; /* 0: none */
    uint8_t sequence;
    uint8_t word; /* whether ARM's payload is the word */
} Request;

static inline uint8_t reader_fits(const Reader *reader) {
    const uint8_t *b = reader->buffer;
    if (b[0] != SYNC) return 0;
    if (reader->filled > 2) {
        if (b[1] != (b[2] == ARM ? WORD_LENGTH : 0)) return 0;
        if (b[2] != ASK_HELLO && b[2] != ASK_ANSWER && b[2] != ARM && b[2] != STOP) return 0;
        if (reader->filled == OVERHEAD + b[1])
            return (uint16_t)(b[4 + b[1]] | (uint16_t)b[5 + b[1]] << 8) == crc16(b + 1, (uint8_t)(3 + b[1]));
    }
    return 1;
}

/* Takes one byte; returns the request that it completes. If no frame fits, a byte is dropped and the search continues. */
static inline Request reader_take(Reader *reader, uint8_t byte) {
    Request request = {0, 0, 0};
    reader->buffer[reader->filled++] = byte;
    while (reader->filled && !reader_fits(reader)) {
        reader->filled--;
        memmove(reader->buffer, reader->buffer + 1, reader->filled);
    }
    if (reader->filled > 2 && reader->filled == OVERHEAD + reader->buffer[1]) {
        request.type = reader->buffer[2];
        request.sequence = reader->buffer[3];
        request.word = reader->buffer[1] && !memcmp(reader->buffer + 4, WORD, WORD_LENGTH);
        reader->filled = 0;
    }
    return request;
}

#endif
