"""Files from strangers, read within bounds: what a file declares is held against a limit before any memory is allocated for it.

A few bytes can declare, or decompress to, any size. Every reader of ours that unpacks something does it here, and every reader runs within
`reading`: what another library raises at a damaged file becomes an error that names the file.
"""

from __future__ import annotations

import gzip
import math
import threading
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import IO

import lz4.frame
import numpy as np
import zstandard

from kinegraph.stream.chunk import Array
from kinegraph.stream.errors import KinegraphError, RecordingError
from kinegraph.stream.system.memory_limit import limited

LEAST = 64 << 20
"""Bytes that any piece of a file may unpack to, however small it is."""
ROOM = 192 << 20
"""Bytes that reading any file may take, beside those that its size allows."""
RATIO = 16
"""A larger piece may unpack to this many times its size."""
WHOLE_RATIO = 500
"""All pieces of a recording together may unpack to this many times its size; what kinegraph writes unpacks to far less, even zeros."""
MIN_WHOLE = 1 << 31
_STEP = 1 << 20
MOST_ROWS = 1 << 48
_MANY_ARRAYS = 10_000


class TooLarge(ValueError):
    """What a file declares, or unpacks to, is beyond the limit."""


def most(packed: int) -> int:
    """Bytes that `packed` bytes from a stranger may unpack to."""
    return max(LEAST, RATIO * packed)


def check_whole(declared: int, packed: int) -> None:
    """Raises TooLarge where the pieces of a recording of `packed` bytes declare more than it may unpack to, `declared` bytes."""
    if declared > (limit := max(MIN_WHOLE, WHOLE_RATIO * packed)):
        raise TooLarge(f"it claims to hold {declared} bytes in {packed}; at most {limit} are unpacked")


def check_size(declared: int, packed: int, what: str = "it") -> int:
    """`declared` bytes, if `packed` ones may unpack to that. Raises TooLarge."""
    if not 0 <= declared <= most(packed):
        raise TooLarge(f"{what} claims to hold {declared} bytes in {packed}; at most {most(packed)} are unpacked")
    return declared


def unpack_zstd(data: bytes | memoryview, size: int) -> bytes:
    """One zstd frame that holds `size` bytes. Raises TooLarge, or ValueError or ZstdError where it is damaged."""
    check_size(size, len(data))
    declared = zstandard.get_frame_parameters(data).content_size
    if declared not in (size, zstandard.CONTENTSIZE_UNKNOWN):
        raise ValueError(f"it claims to hold {declared} bytes, and {size} beside it")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)


def unpack_lz4(data: bytes, size: int) -> bytes:
    """One lz4 frame that holds `size` bytes. Raises TooLarge, or ValueError or RuntimeError where it is damaged."""
    check_size(size, len(data))
    decompressor = lz4.frame.LZ4FrameDecompressor()
    unpacked: bytes = decompressor.decompress(data, max_length=size + 1)
    if len(unpacked) != size:
        more = "more" if len(unpacked) > size else f"{len(unpacked)}"
        raise ValueError(f"it claims to hold {size} bytes, but holds {more}")
    return unpacked


def check_gzip(path: Path) -> None:
    """Raises TooLarge where a gzip file unpacks to more than it may, and OSError, EOFError or zlib.error where it is damaged."""
    limit, held = most(path.stat().st_size), 0
    with gzip.open(path) as file:
        while piece := file.read(_STEP):
            held += len(piece)
            if held > limit:
                raise TooLarge(f"it unpacks to more than {limit} bytes")


def arrays(path: Path, wanted: tuple[str, ...] | None = None) -> dict[str, Array]:
    """The arrays of an NPZ file, or the wanted ones that are there; no pickle is ever loaded.

    Raises OSError, or ValueError that names the array.
    """
    if not zipfile.is_zipfile(path):
        path.open("rb").close()  # raises what tells a missing or unreadable file
        raise ValueError("it is not an NPZ file, or was cut off")
    size = path.stat().st_size
    found: dict[str, Array] = {}
    name = ""
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if len(members) > _MANY_ARRAYS:
                raise TooLarge(f"it holds {len(members)} arrays; at most {_MANY_ARRAYS} are read")
            check_size(sum(member.file_size for member in members), size)
            for member in members:
                name = member.filename.removesuffix(".npy")
                if wanted is None or name in wanted:
                    with archive.open(member) as file:
                        found[name] = _array(file, member.file_size)
    except DAMAGE as error:
        where = f" (array {name!r})" if name else ""
        raise ValueError(f"{str(error) or type(error).__name__}{where}") from None
    return found


def _array(file: IO[bytes], size: int) -> Array:
    """One array of an NPZ file; its header may not declare more than the file holds."""
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(file)
    if dtype.hasobject:
        raise ValueError("Object arrays cannot be loaded: they could run code")
    if min(shape, default=0) < 0 or max(shape, default=0) > MOST_ROWS:
        raise ValueError(f"it claims the shape {shape}")
    count = math.prod(shape)
    if dtype.itemsize and count * dtype.itemsize > size:
        raise ValueError(f"it claims the shape {shape} of {dtype}, but holds {size} bytes")
    if not dtype.itemsize and count > size:
        raise ValueError(f"it claims the shape {shape} of empty values")
    data = bytearray(file.read(count * dtype.itemsize))
    flat = np.frombuffer(data, dtype, count) if dtype.itemsize else np.zeros(count, dtype)
    return flat.reshape(shape[::-1]).T if fortran else flat.reshape(shape)


DAMAGE = (
    *(ValueError, ArithmeticError, LookupError, TypeError, AttributeError, AssertionError, MemoryError, RuntimeError),
    *(EOFError, StopIteration, NotImplementedError, zipfile.BadZipFile, zlib.error, zstandard.ZstdError),
    *(SyntaxError, tokenize.TokenError),  # of the header of an array
)
"""What a library may raise at a damaged file, beside its own errors: whatever its author did not think of."""


@contextmanager
def reading(path: Path, kind: str, error: type[KinegraphError] = RecordingError) -> Iterator[None]:
    """Within: a file is read. Whatever is raised there that is no error of ours becomes one, which names the file.

    A file that cannot be opened is reported in the system's words. `kind` completes the sentence "cannot be read as ...".
    """
    try:
        with _ceiling(path):
            yield
    except (KinegraphError, BrokenPipeError):
        raise
    except MemoryError:
        raise error(f"{path}: needs more memory than a file of its size should; it is damaged or malicious") from None
    except OSError as failed:
        raise error(f"{path}: cannot be read ({failed.strerror or failed})") from None
    except Exception as failed:  # noqa: BLE001 - the one place where whatever a damaged file brings up is met
        raise error(f"{path}: cannot be read as {kind}; it is damaged, or of another kind ({_short(failed)})") from None


def _ceiling(path: Path) -> AbstractContextManager[None]:
    """Within: a command that does nothing else gets no more memory than a file of this size may take, whatever a library asks for."""
    if threading.active_count() > 1 or not path.is_file():
        return nullcontext()
    return limited(room(path))


def room(path: Path) -> int:
    """Bytes that a command that does nothing but read a file, or the files of a session's folder, gets beside those that it has."""
    files = path.iterdir() if path.is_dir() else [path]
    return ROOM + RATIO * sum(file.stat().st_size for file in files if file.is_file())


def _short(failed: Exception) -> str:
    text = " ".join(str(failed).split())
    return f"{text[:200]} ..." if len(text) > 200 else text or type(failed).__name__
