"""The tachometer's firmware: its header compiled on the host, and the whole firmware on a simulated ATmega328P."""

import ctypes
import random
import shutil
import subprocess
from importlib.resources import files
from pathlib import Path

import pytest

from hil.devices.clock import MonotonicClock
from hil.devices.frames import (
    ANSWER,
    ARM,
    ASK_ANSWER,
    ASK_HELLO,
    CLOSED,
    FROM_BOARD,
    FROM_HOST,
    HELLO,
    MEASURED,
    SILENT,
    STALLED,
    STOP,
    WORD,
    Frame,
    FrameReader,
    encoded,
    read_answer,
    read_hello,
)
from hil.devices.tachometer import Tachometer
from hil.emulator.uno import REJECT, SILENCE, STALL, Relay, Rotor
from vpp_fmu.errors import CompilerMissing
from vpp_fmu.native.compiler import compiled

HERE = Path(__file__).parent
SKETCH = files("hil") / "firmware" / "tachometer"
CORE = Path("/usr/share/arduino/hardware/arduino/avr")
HZ = 16_000_000
CYCLES = 64
"""Processor cycles in a tick of 4 us."""


@pytest.fixture(scope="module")
def host():
    source = (HERE / "firmware_host.c").read_text()
    include = '#include "tachometer.h"'
    assert include in source
    try:
        functions = compiled(source.replace(include, (SKETCH / "tachometer.h").read_text()))
    except CompilerMissing as error:
        pytest.skip(str(error))
    functions.extended.restype = ctypes.c_uint32
    return functions


@pytest.fixture
def board(host):
    host.restart()
    return host


def answer(board, now, sequence=0):
    frame = ctypes.create_string_buffer(32)
    length = board.answer(sequence, ctypes.c_uint32(now), frame)
    (found,) = FrameReader(FROM_BOARD).feed(frame.raw[:length])
    assert (found.type, found.sequence) == (ANSWER, sequence)
    return read_answer(found)


def edges(board, *times):
    for t in times:
        board.edge(ctypes.c_uint32(t & 0xFFFFFFFF))


class TestHeader:
    """The board's treatment of mark passes and bytes."""

    def test_greeting(self, board):
        frame = ctypes.create_string_buffer(32)
        length = board.hello(7, frame)
        (found,) = FrameReader(FROM_BOARD).feed(frame.raw[:length])
        assert (found.type, found.sequence, read_hello(found)) == (HELLO, 7, (2, 4, 1250, 50000))

    def test_nothing_has_passed_yet(self, board):
        assert answer(board, 10) == (0, 0, 0, 0xFFFF, STALLED, 0)

    @pytest.mark.parametrize("start", [0, 2**32 - 100, 2**32 - 2500 * 3, 2**31])
    @pytest.mark.parametrize("period", [1250, 2500, 7500, 49_999, 50_000])
    def test_even_marks(self, board, start, period):
        """Count, period, stamp and age in closed form, also across the wrap of the counter."""
        for k in range(10):
            edges(board, start + k * period)
            now = start + k * period + 1000
            expected = (k + 1, (start + k * period) % 2**32, period if k else 0, 1000, MEASURED if k else 0, 0)
            assert answer(board, now % 2**32, k) == expected

    def test_an_edge_within_5_ms_is_rejected_and_the_next_is_timed_from_the_last_good_one(self, board):
        edges(board, 0, 1249, 2500)
        assert answer(board, 2500) == (2, 2500, 2500, 0, MEASURED, 1)
        edges(board, 2500 + 1250)
        assert answer(board, 4000)[2:] == (1250, 250, MEASURED, 1)

    def test_a_stall_is_more_than_200_ms(self, board):
        edges(board, 0, 2500)
        assert answer(board, 2500 + STALL)[2:5] == (2500, STALL, MEASURED)
        assert answer(board, 2500 + STALL + 1) == (2, 2500, 0, 0xFFFF, STALLED, 0)
        assert answer(board, 2500) == (2, 2500, 0, 0xFFFF, STALLED, 0)  # latched until the mark passes
        edges(board, 60_000)
        assert answer(board, 60_100) == (3, 60_000, 0, 100, 0, 0)
        edges(board, 62_500)
        assert answer(board, 62_500)[2] == 2500

    def test_a_revolution_that_took_longer_than_a_stall_has_no_period_though_nobody_looked(self, board):
        edges(board, 0, STALL + 1)
        assert answer(board, STALL + 1)[2] == 0

    def test_an_edge_after_a_whole_turn_of_the_counter_is_no_bounce(self, board):
        """4 h 46 min after the last mark the difference is small again; only the recorded stall excludes a bounce."""
        edges(board, 1000)
        board.watch(ctypes.c_uint32(1000 + STALL + 1))
        edges(board, 1000 + 100)
        assert answer(board, 1200) == (2, 1100, 0, 100, 0, 0)

    def test_the_timers_16_bits_become_32_whenever_it_is_read(self, board):
        """All orders of a read, the overflow and its flag."""
        for true in [*range(0x1FFF0, 0x20010), 0xFFFFFFFF, 0xFFFF0000]:
            count, rounds = true & 0xFFFF, true >> 16 & 0xFFFF
            assert board.extended(rounds, count, 0) == true
            if count < 0x8000:  # the overflow's interrupt has not run yet
                assert board.extended(rounds - 1 & 0xFFFF, count, 1) == true
            else:  # the flag came up between the two reads
                assert board.extended(rounds, count, 1) == true

    @pytest.mark.parametrize("seed", range(5))
    def test_the_emulated_board_does_the_same(self, board, seed):
        """Random passes, bounces, stalls and requests, from a counter about to wrap."""
        chance, rotor, now = random.Random(seed), Rotor(), 2**32 - 100_000
        for k in range(3000):
            now = now + chance.choice((3, 700, 1249, 1250, 2500, 2503, 7500, STALL, STALL + 1, 90_000)) & 0xFFFFFFFF
            if chance.random() < 0.5:
                rotor.edge(now)
                edges(board, now)
            else:
                assert answer(board, now, k & 0xFF) == rotor.answer(now)
        assert rotor.pulses > 500
        assert rotor.rejected > 0

    @pytest.mark.parametrize("seed", range(5))
    def test_board_and_host_find_the_same_requests_among_damage(self, board, seed):
        chance, reader, stream = random.Random(seed), FrameReader(FROM_HOST), bytearray()
        for k in range(500):
            kind = chance.choice((ASK_ANSWER, ASK_HELLO, ARM, STOP))
            data = bytearray(encoded(Frame(kind, k & 0xFF, chance.choice((WORD, b"SPIM")) if kind == ARM else b"")))
            if chance.random() < 0.3:
                data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
            stream += chance.choice((b"", b"", b"\x7e", b"\x7e\x00", chance.randbytes(9))) + data
        wanted = [(frame.payload == WORD, frame.type, frame.sequence) for frame in reader.feed(bytes(stream))]
        found = [(bool(taken >> 16), taken >> 8 & 0xFF, taken & 0xFF) for taken in map(board.take, stream) if taken]
        assert found == wanted
        assert len(found) > 300

    def test_the_relay_is_closed_by_the_word_held_by_requests_and_opens_100_ms_after_the_last(self, board):
        assert board.relay_at(0) == 0
        board.asked(10)
        assert board.relay_at(20) == 0  # requests alone close nothing
        board.arm(1000)
        for now in range(1000, 200_000, 1000):
            board.asked(now)
            assert board.relay_at(now + 999) == CLOSED
        assert board.relay_at(199_000 + SILENCE) == CLOSED
        assert board.relay_at(199_000 + SILENCE + 1) == SILENT
        board.asked(225_000)
        assert board.relay_at(225_001) == SILENT  # it waits for the word
        board.arm(226_000)
        assert board.relay_at(226_001) == CLOSED
        board.stop()
        assert board.relay_at(226_002) == 0

    @pytest.mark.parametrize("seed", range(5))
    def test_the_emulated_relay_does_the_same(self, board, seed):
        chance, relay, now, seen = random.Random(seed), Relay(), 2**32 - 100_000, set()
        for _ in range(3000):
            now = now + chance.choice((3, 1000, 1000, 1000, 24_999, SILENCE, SILENCE + 1)) & 0xFFFFFFFF
            what = chance.choice(("arm", "heard", "heard", "heard", "stop"))
            relay.watch(now)
            board.relay_at(ctypes.c_uint32(now))
            if what == "arm":
                relay.arm(now)
                board.arm(ctypes.c_uint32(now))
            elif what == "heard":
                relay.heard(now)
                board.asked(ctypes.c_uint32(now))
            else:
                relay.stop()
                board.stop()
            assert board.relay_at(ctypes.c_uint32(now)) == relay.flags
            seen.add(relay.flags)
        assert seen == {0, CLOSED, SILENT}


@pytest.fixture(scope="module")
def avr():
    compiler = shutil.which("avr-g++")
    if compiler is None:
        pytest.skip("no avr-g++ (packages gcc-avr, avr-libc)")
    return compiler


@pytest.fixture(scope="module")
def firmware(avr, tmp_path_factory):
    """The sketch as plain avr-g++ builds it."""
    elf = tmp_path_factory.mktemp("avr") / "tachometer.elf"
    flags = ["-mmcu=atmega328p", "-DF_CPU=16000000UL", "-Os", "-Wall", "-Wextra", "-Werror", "-x", "c++"]
    subprocess.run([avr, *flags, str(SKETCH / "tachometer.ino"), "-o", str(elf)], check=True)
    return elf


@pytest.fixture(scope="module")
def simulator(tmp_path_factory):
    """simavr with the board's pins."""
    compiler = shutil.which("cc") or pytest.skip("no C compiler for simavr's host")
    binary = tmp_path_factory.mktemp("simavr") / "simavr_host"
    command = [compiler, "-O2", str(HERE / "simavr_host.c"), "-o", str(binary), "-lsimavr", "-lelf", "-lutil"]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("no simavr to build with (packages libsimavr-dev, libelf-dev)")
    return binary


def simulated(simulator, firmware, events, end):
    """[(time [s], frame)] that the board sends on events (time [s], "edge" or bytes), and the number of bytes in no frame."""
    done = run_script(simulator, firmware, events, end)
    reader, said = FrameReader(FROM_BOARD), []
    for line in done.splitlines():
        if line.startswith("relay"):
            continue
        cycle, byte = map(int, line.split())
        said += [(cycle / HZ, frame) for frame in reader.feed(bytes([byte]))]
    return said, reader.dropped


def switched(simulator, firmware, events, end):
    """[(time [s], level)] of the relay's pin."""
    lines = [line.split() for line in run_script(simulator, firmware, events, end).splitlines() if line.startswith("relay")]
    return [(int(cycle) / HZ, int(level)) for _, cycle, level in lines]


def run_script(simulator, firmware, events, end):
    """Output of the simulated board for events."""
    lines = []
    for when, what in events:
        cycle = round(when * HZ)
        if what == "edge":
            lines.append((cycle, f"edge {cycle}"))
        else:
            spaced = ((cycle + 320 * k, byte) for k, byte in enumerate(what))
            lines += [(at, f"byte {at} {byte}") for at, byte in spaced]
    lines.sort()
    script = "\n".join([*(line for _, line in lines), f"end {round(end * HZ)}\n"])
    return subprocess.run([simulator, firmware, "script"], input=script, capture_output=True, text=True, check=True).stdout


def asked(times):
    return [(when, encoded(Frame(ASK_ANSWER, k & 0xFF))) for k, when in enumerate(times)]


@pytest.fixture(scope="module")
def zero(simulator, firmware):
    """Start of the board's timer [s]: some microseconds after the reset, once memory is cleared."""
    said, _ = simulated(simulator, firmware, [(0.1, "edge"), *asked([0.101])], 0.11)
    start = 0.1 - read_answer(said[-1][1]).stamp * CYCLES / HZ
    assert 0.0 < start < 100e-6
    return start


class TestSimulated:
    """The real machine code, cycle by cycle."""

    def test_it_greets_once_and_then_answers_every_request_within_a_millisecond(self, simulator, firmware):
        times = [0.003 + 0.004 * k for k in range(250)]
        said, dropped = simulated(simulator, firmware, asked(times), 1.1)
        assert dropped == 0
        assert (said[0][1].type, read_hello(said[0][1])) == (HELLO, (2, 4, REJECT, STALL))
        assert [frame.sequence for _, frame in said[1:]] == [k & 0xFF for k in range(250)]
        # 6 bytes of request and 20 of answer are 0.52 ms at 500 kBd.
        assert max(when - t for (when, _), t in zip(said[1:], times, strict=True)) < 0.001

    @pytest.mark.parametrize("omega", [2000.0, 4000.0, 6000.0])
    def test_it_answers_as_the_emulated_board(self, simulator, firmware, zero, omega):
        """Random bounces and a stop, while the line is busy: equal counts, times within two ticks."""
        chance, rotor, period = random.Random(omega), Rotor(), 60.0 / omega
        passes = [0.01 + period * k for k in range(round(1.2 / period)) if not 0.5 < period * k < 0.8]
        bounces = [t + chance.uniform(0.0005, 0.0045) for t in passes if chance.random() < 0.2]
        all_edges = sorted(passes + bounces)
        times = [t for t in (0.02 + 0.0041 * k for k in range(280)) if all(abs(t - e) > 1e-3 for e in all_edges)]
        events = [(t, "edge") for t in all_edges] + asked(times)
        said, _ = simulated(simulator, firmware, events, 1.25)
        assert len(said) == len(times) + 1
        waiting = iter(all_edges)
        upcoming = next(waiting)
        for sent, frame in zip(times, (frame for _, frame in said[1:]), strict=True):
            now = sent + 6 * 20e-6  # the request is complete
            while upcoming is not None and upcoming < now:
                rotor.edge(int((upcoming - zero) * HZ / CYCLES))
                upcoming = next(waiting, None)
            ours, real = rotor.answer(int((now - zero) * HZ / CYCLES)), read_answer(frame)
            assert (real.pulses, real.rejected, real.flags) == (ours.pulses, ours.rejected, ours.flags)
            assert real.period == pytest.approx(ours.period, abs=2)
            assert real.stamp == pytest.approx(ours.stamp, abs=2)
            assert real.age == pytest.approx(ours.age, abs=20)  # the board's loop takes a while to look at a byte

    def test_a_pass_is_timed_right_whenever_the_timer_overflows(self, simulator, firmware, zero):
        """Edges from 12 us before to 12 us after an overflow of the 16 bits: a lost carry would be an error of 262 ms."""
        overflow = 65536 * CYCLES / HZ
        passes = [zero + (k + 1) * overflow + (k - 12) * 1e-6 for k in range(25)]
        times = [t + 0.003 for t in passes]
        said, _ = simulated(simulator, firmware, [(t, "edge") for t in passes] + asked(times), times[-1] + 0.01)
        stamps = [read_answer(frame).stamp for _, frame in said[1:]]
        assert stamps == pytest.approx([(t - zero) * HZ / CYCLES for t in passes], abs=3)

    def test_damaged_requests_get_no_answer_and_cost_no_other_one(self, simulator, firmware):
        chance, events, good = random.Random(4), [], []
        for k in range(200):
            data = bytearray(encoded(Frame(ASK_ANSWER, k)))
            if chance.random() < 0.5:
                data[chance.randrange(6)] ^= 1 << chance.randrange(8)
            else:
                good.append(k)
            events.append((0.003 + 0.004 * k, bytes(data)))
            events.append((0.0045 + 0.004 * k, chance.randbytes(3)))
        said, dropped = simulated(simulator, firmware, [*events, (0.9, bytes(12))], 1.0)
        answered = [frame.sequence for _, frame in said[1:]]
        assert dropped == 0
        assert set(good) - set(answered) == set()
        assert len(answered) == len(good)

    def test_the_relays_pin_follows_the_word_and_opens_100_ms_after_the_last_request(self, simulator, firmware):
        arm = encoded(Frame(ARM, 0, WORD))
        requests = asked([0.02 + 0.004 * k for k in range(50)])
        pin = switched(simulator, firmware, [(0.01, arm), *requests, (0.5, arm), (0.55, encoded(Frame(STOP, 0)))], 0.8)
        changes = [(t, level) for (t, level), (_, before) in zip(pin, [(0.0, 0), *pin], strict=False) if level != before]
        assert [level for _, level in changes] == [1, 0, 1, 0]
        closed, opened, again, stopped = (t for t, _ in changes)
        assert closed == pytest.approx(0.01 + 10 * 20e-6, abs=100e-6)  # the word's ten bytes
        last = requests[-1][0] + 6 * 20e-6
        assert opened - last == pytest.approx(0.1, abs=100e-6)
        assert again == pytest.approx(0.5 + 10 * 20e-6, abs=100e-6)
        assert stopped == pytest.approx(0.55 + 6 * 20e-6, abs=100e-6)

    def test_no_damage_closes_the_relay(self, simulator, firmware):
        chance, events = random.Random(5), []
        for k in range(200):
            data = bytearray(encoded(Frame(ARM, k, WORD)))
            data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
            events.append((0.003 + 0.004 * k, bytes(data)))
        events.append((0.9, encoded(Frame(ARM, 1, b"SPIM"))))
        assert all(level == 0 for _, level in switched(simulator, firmware, events, 1.0))

    def test_the_real_driver_over_a_pty(self, simulator, firmware):
        """pyserial, the frames and the firmware in real time; the mark passes every 15 ms."""
        command = [simulator, firmware, "pty", "15000"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            clock, answers = MonotonicClock(), []
            tachometer = Tachometer(process.stdout.readline().strip(), clock, timeout=5.0)
            assert tachometer.hello() == (2, 4, REJECT, STALL)
            for _ in range(150):
                tachometer.request()
                clock.wait_until(clock.now() + 0.004)
                answers.append(tachometer.poll())
            tachometer.close()
            assert process.wait(20) == 0
        good = [a for a in answers if a is not None]
        assert len(good) > 15  # nearly all, unless the machine is busy
        assert good[-1].omega == pytest.approx(4000.0, rel=2e-3)
        assert tachometer.counters["damaged"] == 0


def test_the_arduino_core_builds_it_too(avr, tmp_path):
    """As the Arduino IDE does: its own main, its interrupts linked only where they are used."""
    if not CORE.exists():
        pytest.skip("no Arduino core (package arduino-core-avr)")
    common = ["-mmcu=atmega328p", "-DF_CPU=16000000UL", "-DARDUINO=10808", "-DARDUINO_AVR_UNO", "-DARDUINO_ARCH_AVR", "-Os"]
    common += ["-ffunction-sections", "-fdata-sections", "-flto", "-fno-fat-lto-objects", "-w"]
    common += [f"-I{CORE}/cores/arduino", f"-I{CORE}/variants/standard", f"-I{SKETCH}"]
    sketch = tmp_path / "tachometer.ino.cpp"
    sketch.write_text(f'#include <Arduino.h>\n#include "{SKETCH / "tachometer.ino"}"\n')
    objects = []
    needed = ("main.cpp", "wiring.c", "hooks.c", "WInterrupts.c", "HardwareSerial.cpp", "HardwareSerial0.cpp")
    for source in [sketch, *(CORE / "cores" / "arduino" / name for name in needed)]:
        objects.append(tmp_path / f"{source.name}.o")
        language = ["-std=gnu11"] if source.suffix == ".c" else ["-std=gnu++11", "-fno-exceptions", "-fno-threadsafe-statics"]
        subprocess.run([avr.replace("g++", "gcc"), *common, *language, "-c", source, "-o", objects[-1]], check=True)
    archive = tmp_path / "core.a"
    subprocess.run([avr.replace("g++", "gcc-ar"), "rcs", archive, *objects[1:]], check=True)
    link = [avr.replace("g++", "gcc"), "-Os", "-flto", "-fuse-linker-plugin", "-Wl,--gc-sections", "-mmcu=atmega328p"]
    subprocess.run([*link, "-o", tmp_path / "tachometer.elf", objects[0], archive, "-lm"], check=True)
    symbols = subprocess.run(["avr-nm", tmp_path / "tachometer.elf"], capture_output=True, text=True, check=True).stdout
    assert " T __vector_1\n" in symbols  # the mark's interrupt is ours
    assert " T __vector_18\n" in symbols  # and the line's
    assert "Serial" not in symbols
