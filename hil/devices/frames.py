"""Frames on the tachometer's serial line: encode them, and find them in a stream of bytes that may be damaged.

A frame is the sync byte 0x7E, the length of its payload, its type, a sequence number, the payload and a CRC-16, all numbers
little-endian. The CRC is CRC-16/IBM-3740, also called CCITT-FALSE: polynomial 0x1021, start 0xFFFF, not reflected, not
inverted. It covers all bytes between sync and CRC, and detects every error of up to three bits and every burst of up to 16.
`hil/firmware/tachometer/tachometer.h` defines the same in C.
"""

import struct
from binascii import crc_hqx
from collections.abc import Mapping
from typing import NamedTuple

SYNC = 0x7E
OVERHEAD = 6
"""Bytes of a frame that are not payload."""

ASK_HELLO, ASK_ANSWER, HELLO, ANSWER, ARM, STOP = 0x96, 0x69, 0x3C, 0xC3, 0xA5, 0x5A
"""Types: they differ in at least four bits, so that fewer wrong bits do not turn one into another."""

WORD = b"SPIN"
"""ARM's payload: it closes the relay in the ESC's supply. STOP opens it, and so do `SILENCE` s without a request."""
SILENCE = 0.1

VERSION = 2
TICK = 4e-6
"""Resolution of the board's timer [s]: 16 MHz / 64."""

STALLED, MEASURED, CLOSED, SILENT = 0x01, 0x02, 0x04, 0x08
"""Flags of an answer: no mark for 200 ms; `period` holds a whole revolution; the relay is closed; it opened for lack of
requests, and was not armed since."""

_HELLO, _ANSWER = struct.Struct("<BBHH"), struct.Struct("<LLHHBB")
FROM_HOST: Mapping[int, int] = {ASK_HELLO: 0, ASK_ANSWER: 0, ARM: len(WORD), STOP: 0}
FROM_BOARD: Mapping[int, int] = {HELLO: _HELLO.size, ANSWER: _ANSWER.size}
"""Payload length of each type, by sender: any other length is an error."""


class Frame(NamedTuple):
    """Content of a frame."""

    type: int
    sequence: int
    payload: bytes = b""


class Hello(NamedTuple):
    """The board's greeting after a reset or on request: protocol version, timer tick [us], REJECT and STALL times [ticks]."""

    version: int
    tick: int
    reject: int
    stall: int

    def packed(self) -> bytes:
        return _HELLO.pack(*self)


class Answer(NamedTuple):
    """The rotor as measured by the board: `pulses` since reset; `stamp`, the board's time of the last one [ticks, wraps];
    `period` of the last whole revolution and `age` of the last pulse [ticks, at most 65535]; `flags`; edges `rejected` because
    they came too early (wraps)."""

    pulses: int
    stamp: int
    period: int
    age: int
    flags: int
    rejected: int

    def packed(self) -> bytes:
        return _ANSWER.pack(*self)


def read_hello(frame: Frame) -> Hello:
    return Hello(*_HELLO.unpack(frame.payload))


def read_answer(frame: Frame) -> Answer:
    return Answer(*_ANSWER.unpack(frame.payload))


def crc16(data: bytes) -> int:
    """CRC-16/IBM-3740 of the bytes."""
    return crc_hqx(data, 0xFFFF)


def encoded(frame: Frame) -> bytes:
    body = bytes((len(frame.payload), frame.type, frame.sequence)) + frame.payload
    return bytes((SYNC,)) + body + crc16(body).to_bytes(2, "little")


class FrameReader:
    """Finds the frames in a stream. `lengths`: payload length of each type that may come.

    If a frame fails its checks, one byte is dropped and the search continues, so a good frame after a damaged one is never
    lost. `received`: bytes in all; `dropped`: bytes that were part of no frame; `damaged`: frames with a wrong CRC.
    """

    def __init__(self, lengths: Mapping[int, int]):
        self._lengths, self._buffer = dict(lengths), bytearray()
        self.received = self.dropped = self.damaged = 0

    def feed(self, data: bytes) -> list[Frame]:
        """Add bytes; returns the frames that they complete."""
        self.received += len(data)
        self._buffer += data
        frames = []
        while (frame := self._next()) is not None:
            frames.append(frame)
        return frames

    def forget(self) -> None:
        """Drop the bytes of an incomplete frame."""
        self._drop(len(self._buffer))

    def _next(self) -> Frame | None:
        buffer = self._buffer
        while buffer:
            start = buffer.find(SYNC)
            self._drop(len(buffer) if start < 0 else start)
            if len(buffer) < 3:
                return None
            length, kind = buffer[1], buffer[2]
            if self._lengths.get(kind) != length:
                self._drop(1)
                continue
            end = length + OVERHEAD
            if len(buffer) < end:
                return None
            if crc16(buffer[1 : end - 2]) == int.from_bytes(buffer[end - 2 : end], "little"):
                frame = Frame(kind, buffer[3], bytes(buffer[4 : end - 2]))
                del buffer[:end]
                return frame
            self.damaged += 1
            self._drop(1)
        return None

    def _drop(self, count: int) -> None:
        del self._buffer[:count]
        self.dropped += count
