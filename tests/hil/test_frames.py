import itertools
import random

import pytest

from hil.devices.frames import ANSWER, ASK_ANSWER, FROM_BOARD, Answer, Frame, FrameReader, encoded

ANSWERED = Frame(ANSWER, 0x7E, Answer(123456, 0x7E7E0001, 2500, 7, 2, 0).packed())
"""A frame with sync bytes at the worst places: in the sequence number and in the payload."""
NEXT = Frame(ANSWER, 0x7F, Answer(123457, 0x7E7E09C5, 2500, 507, 2, 0).packed())


def bitwise_crc(data: bytes) -> int:
    """The catalogue's definition, bit by bit: polynomial 0x1021, start 0xFFFF, no reflection, no final inversion."""
    register = 0xFFFF
    for bit in "".join(f"{byte:08b}" for byte in data):
        out = register >> 15 ^ int(bit)
        register = register << 1 & 0xFFFF ^ 0x1021 * out
    return register


def flipped(data: bytes, bits) -> bytes:
    number = int.from_bytes(data, "big")
    for bit in bits:
        number ^= 1 << bit
    return number.to_bytes(len(data), "big")


def test_bytes_on_the_line():
    """Written out by hand from the description of a frame; only the CRC is computed."""
    body = bytes([0, 0x69, 5])
    assert encoded(Frame(ASK_ANSWER, 5)) == b"\x7e\x00\x69\x05" + bitwise_crc(body).to_bytes(2, "little")
    payload = bytes.fromhex("40e20100 01007e7e c409 0700 02 00")
    body = bytes([14, 0xC3, 0x7E]) + payload
    assert encoded(ANSWERED) == b"\x7e" + body + bitwise_crc(body).to_bytes(2, "little")


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_frames_come_in_any_pieces(count):
    data, reader, found = encoded(ANSWERED) + encoded(NEXT), FrameReader(FROM_BOARD), []
    for at in range(0, len(data), count):
        found += reader.feed(data[at : at + count])
    assert found == [ANSWERED, NEXT]
    assert (reader.received, reader.dropped, reader.damaged) == (len(data), 0, 0)


def damages():
    """Every flip of one and of two bits, many of three, and every burst of 3 to 16 bits with a random inside."""
    chance, bits = random.Random(1), range(8 * len(encoded(ANSWERED)))
    yield from ((bit,) for bit in bits)
    yield from itertools.combinations(bits, 2)
    yield from (chance.sample(bits, 3) for _ in range(20_000))
    for length in range(3, 17):
        for first in range(len(bits) - length + 1):
            inside = [bit for bit in range(first + 1, first + length - 1) if chance.random() < 0.5]
            yield (first, *inside, first + length - 1)


def test_a_damaged_frame_never_gives_a_wrong_value_and_never_costs_the_next_one():
    data, behind = encoded(ANSWERED), encoded(NEXT)
    for bits in damages():
        reader = FrameReader(FROM_BOARD)
        found = reader.feed(flipped(data, bits) + behind + behind)  # twice: a damaged head may wait for bytes of the first
        assert found == [NEXT, NEXT], bits
        assert reader.dropped == len(data)


def test_random_bytes_hold_no_frame_and_hide_none():
    chance, reader = random.Random(2), FrameReader(FROM_BOARD)
    for _ in range(2000):
        noise = chance.randbytes(chance.randint(1, 60))
        assert set(reader.feed(noise + encoded(NEXT) + bytes(40))) == {NEXT}  # the zeros complete a frame in the noise
    assert reader.received == reader.dropped + 2000 * len(encoded(NEXT))


def test_a_cut_off_frame_is_dropped_once_the_next_one_is_whole():
    data = encoded(ANSWERED)
    for kept in range(1, len(data)):
        reader = FrameReader(FROM_BOARD)
        assert reader.feed(data[:kept]) == []
        found = reader.feed(encoded(NEXT) + encoded(NEXT))
        assert found == [NEXT, NEXT]
