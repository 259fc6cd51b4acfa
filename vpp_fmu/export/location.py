"""A mend of pythonfmu's binary: `fmi2Instantiate` decodes the URI of its resources (`fmu_src/upstream/` has a patch).

pythonfmu 0.7.0 decodes %20 only, and a path with any other escape ends in a crash: a host writes ü as %C3%BC and + as %2B. No
code of an FMU runs before that call. So the binary itself is changed, if it is ELF for x86-64: the symbol `fmi2Instantiate`
points to the machine code of `fmu_src/location.s`, in the unused end of the last page of code. That code decodes all escapes
and calls the original. The original's pattern "%20" becomes one that matches nothing, because a folder's name may contain it.
"""

import struct

CODE = bytes.fromhex(
    "f30f1efa554889e5534885c974554989ca41803a004d8d520175f64929ca4c29"
    "d44989ca4889e14989e3418a1a49ffc280fb257524418a02e83c000000731a88"
    "c3418a4201e82f000000730bc0e30408c34983c202eb02b32541881b49ffc384"
    "db75c74883e4f04883ec08ff7510e81a000000488b5df8c9c30c202c303c0a72"
    "082c273c0a72033c10c338c0c3"
)
"""`fmu_src/location.s`, assembled."""

CALL = CODE.index(b"\xe8", CODE.index(b"\xff\x75\x10")) + 1
"""Place of the distance to the original, relative to the end of these four bytes."""

PATTERN, NEVER = b"\0%20\0", b"\0$a\0\0"
"""The original's regular expression, and one that would need a letter after the end."""

HEADER, SEGMENT, SECTION, SYMBOL = (
    struct.Struct(f"<{form}") for form in ("16sHHIQQQIHHHHHH", "IIQQQQQQ", "IIQQQQIIQQ", "IBBHQQ")
)
X86_64, EXECUTABLE, DYNAMIC_SYMBOLS = 62, 1, 11


def decoding(binary: bytes) -> bytes:
    """The binary with the mend; unchanged if it is for another system, or its version decodes more than %20."""
    if binary[:6] != b"\x7fELF\x02\x01" or binary.count(PATTERN) != 1:
        return binary
    data = bytearray(binary.replace(PATTERN, NEVER))
    _, _, machine, _, _, segments, sections, _, _, _, count, _, n_sections, _ = HEADER.unpack_from(data)
    if machine != X86_64:
        return binary
    for at in range(segments, segments + count * SEGMENT.size, SEGMENT.size):
        kind, flags, offset, address, physical, size, _, align = SEGMENT.unpack_from(data, at)
        if kind == 1 and flags & EXECUTABLE:
            break
    place = -(-size // 16) * 16
    room = data[offset + size : offset + -(-size // align) * align]
    if place - size + len(CODE) > len(room) or any(room):
        return binary
    symbol = _symbol(data, sections, n_sections, b"fmi2Instantiate")
    name, info, other, section, original, _ = SYMBOL.unpack_from(data, symbol)
    code = bytearray(CODE)
    struct.pack_into("<i", code, CALL, original - (address + place + CALL + 4))
    data[offset + place : offset + place + len(code)] = code
    SEGMENT.pack_into(data, at, kind, flags, offset, address, physical, place + len(code), place + len(code), align)
    SYMBOL.pack_into(data, symbol, name, info, other, section, address + place, len(code))
    return bytes(data)


def _symbol(data: bytes, sections: int, count: int, wanted: bytes) -> int:
    """Place of a symbol in the table that the dynamic linker reads."""
    found = [SECTION.unpack_from(data, sections + k * SECTION.size) for k in range(count)]
    table = next(section for section in found if section[1] == DYNAMIC_SYMBOLS)
    names, first = found[table[6]][4], table[4]
    for at in range(first, first + table[5], SYMBOL.size):
        name = names + SYMBOL.unpack_from(data, at)[0]
        if data[name : name + len(wanted) + 1] == wanted + b"\0":
            return at
    raise KeyError(wanted)
