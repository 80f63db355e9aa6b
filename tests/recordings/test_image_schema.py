"""The schema of recorded images: the numbers that Foxglove gives the fields of foxglove.RawImage."""

from __future__ import annotations

from stream.recording.image import descriptor

NUMBERS = {"timestamp": 1, "frame_id": 7, "width": 2, "height": 3, "encoding": 4, "step": 5, "data": 6}
FIELD, NAME, NUMBER = 0x12, 0x0A, 0x18
"""Tags within a message's descriptor: a field of the message; a field's name, and its number."""


def test_fields_of_an_image_have_the_numbers_of_foxglove() -> None:
    schema = descriptor()
    image = schema[schema.index(b"foxglove/RawImage.proto") :]
    for name, number in NUMBERS.items():
        at = image.index(bytes([NAME, len(name)]) + name.encode()) + 2 + len(name)
        assert image[at] == NUMBER and image[at + 1] == number, name
