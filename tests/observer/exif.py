"""Photos that say when they were taken."""


def exif(taken: str) -> bytes:
    """Return an EXIF segment that says when a photo was taken."""
    text = taken.encode() + b"\x00"
    first = b"\x01\x00" + b"\x69\x87\x04\x00\x01\x00\x00\x00" + (26).to_bytes(4, "little") + bytes(4)
    inner = b"\x01\x00" + b"\x03\x90\x02\x00" + len(text).to_bytes(4, "little") + (44).to_bytes(4, "little") + bytes(4)
    return b"\xff\xe1\x00\x80Exif\x00\x00II*\x00\x08\x00\x00\x00" + first + inner + text
