/* Functions of the firmware's header for Python. */
#include "tachometer.h"

static Rotor rotor;
static Reader reader;
static Relay relay;

void restart(void) {
    memset(&rotor, 0, sizeof rotor);
    memset(&reader, 0, sizeof reader);
    memset(&relay, 0, sizeof relay);
}

void edge(uint32_t now) { rotor_edge(&rotor, now); }

void watch(uint32_t now) { rotor_watch(&rotor, now); }

unsigned hello(unsigned sequence, uint8_t *frame) { return write_hello(frame, (uint8_t)sequence); }

unsigned answer(unsigned sequence, uint32_t now, uint8_t *frame) {
    rotor_watch(&rotor, now);
    return write_answer(frame, (uint8_t)sequence, &rotor, relay_flags(&relay), now);
}

void arm(uint32_t now) { relay_arm(&relay, now); }

void asked(uint32_t now) { relay_heard(&relay, now); }

void stop(void) { relay_stop(&relay); }

/* Check the relay, then return its flags of the answer. */
unsigned relay_at(uint32_t now) {
    relay_watch(&relay, now);
    return relay_flags(&relay);
}

/* The request that the byte completes: whether it has the word (bit 16), its type and sequence; 0: no request. */
unsigned take(unsigned byte) {
    Request request = reader_take(&reader, (uint8_t)byte);
    return (unsigned)request.word << 16 | (unsigned)request.type << 8 | request.sequence;
}

unsigned extended(unsigned overflows, unsigned count, unsigned pending) {
    return ticks((uint16_t)overflows, (uint16_t)count, (uint8_t)pending);
}
