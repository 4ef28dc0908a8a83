"""Arrays out of files that were made elsewhere: NumPy, CSV, pictures, and lists in source code.

Nothing is run: source code is read for its numbers alone. What a file may hold is bounded before
room is made for it.
"""

from __future__ import annotations

import math
import os
import re
import struct
import tokenize
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from albedo.errors import InputError

MOST_NUMBERS = 2**22
"""Numbers that an array may have."""
MOST_BYTES = 2**27
"""Bytes that a file may have."""
# Characters of a reason.
_SAID = 400

_NUMBER = re.compile(
    r"[-+]?(?:0[xX][0-9a-fA-F]*\.?[0-9a-fA-F]*[pP][-+]?\d+|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
)
# What begins with a letter holds digits that are no numbers, such as vec2 or x1.
_WORD = re.compile(r"(?<![\w.])[A-Za-z_$][\w$]*")
_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
_CLOSING = {"{": "}", "[": "]", "(": ")"}


def load_array(path: str | os.PathLike[str]) -> np.ndarray:
    """Read an array of numbers.

    Parameters
    ----------
    path : path
        ``.npy``; ``.csv`` or ``.txt`` of rows of numbers; ``.exr``, ``.png`` or ``.dds``; or
        source code (``.h``, ``.c``, ``.cpp``, ``.glsl``, ``.hlsl``, ``.js``, ``.ts``, ``.py``,
        ``.rs``), whose longest list of numbers is taken.

    Returns
    -------
    ndarray
        Of rows and columns, and of channels where each place has several numbers; a list in source
        code whose shape is not told is flat. Shares of pictures are of 1.

    Raises
    ------
    InputError
        For a file that is none of these, or holds no array of numbers.
    """
    target = Path(path)
    reader = _READERS.get(target.suffix.lower())
    if reader is None:
        raise InputError(
            f"'{target}' is of no kind that is read; it ends in one of {', '.join(_READERS)}"
        )
    try:
        size = target.stat().st_size
    except OSError as error:
        raise InputError(f"'{target}' cannot be read: {error.strerror}") from None
    if not target.is_file():
        raise InputError(f"'{target}' is no file")
    if size > MOST_BYTES:
        raise InputError(f"'{target}' has {size} bytes; what is read has at most {MOST_BYTES}")
    try:
        # What is no number is refused below.
        with np.errstate(invalid="ignore", over="ignore"):
            found = np.asarray(reader(target), dtype=np.float64)
    except InputError as error:
        # What libraries say may have several lines.
        said = " ".join(str(error).split())[:_SAID]
        raise InputError(f"'{target}' is not read: {said}") from None
    if not 4 <= found.size <= MOST_NUMBERS or not 1 <= found.ndim <= 3:
        raise InputError(f"'{target}' holds no table: an array of shape {found.shape}")
    if not np.isfinite(found).all():
        raise InputError(f"'{target}' holds numbers that are not finite")
    return found


def _npy(path: Path) -> np.ndarray:
    try:
        with path.open("rb") as file:
            version = np.lib.format.read_magic(file)
            read = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }[version]
            shape, _, dtype = read(file)
            if dtype.kind not in "fiu" or math.prod(shape) > MOST_NUMBERS:
                raise InputError(f"it holds {dtype} numbers of shape {shape}")
        found: np.ndarray = np.load(path, allow_pickle=False)
    except InputError:
        raise
    except (OSError, ValueError, KeyError, EOFError, SyntaxError, tokenize.TokenError) as error:
        raise InputError(f"it is no array of NumPy: {error}") from None
    return found if found.dtype.kind == "f" else found / float(np.iinfo(found.dtype).max)


def _rows(path: Path) -> np.ndarray:
    """Rows of numbers between commas, blanks or semicolons; a first row of words is left out."""
    rows = []
    for line in _text(path).splitlines():
        plain = line.partition("#")[0].strip()
        if not plain:
            continue
        try:
            rows.append([float(word) for word in re.split(r"[,;\s]+", plain.strip(",; "))])
        except ValueError:
            if rows:
                raise InputError(f"its row {plain[:40]!r} has what is no number") from None
    if not rows or len({len(row) for row in rows}) > 1:
        raise InputError("it has no rows of equally many numbers")
    return np.array(rows)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except ValueError:
        raise InputError("it is no text") from None


def _source(path: Path) -> np.ndarray:
    """The longest list of numbers in source code; nested lists tell its shape."""
    text = _COMMENT.sub(" ", _text(path)) if path.suffix != ".py" else _text(path)
    best: np.ndarray | None = None
    for start, end in _outermost(text):
        piece = text[start:end]
        numbers = _numbers(piece)
        if best is None or numbers.size > best.size:
            best = _shaped(piece, numbers)
    if best is None or best.size < 4:
        raise InputError("it has no list of numbers")
    return best


def _outermost(text: str) -> list[tuple[int, int]]:
    """Where lists begin and end that hold nothing but numbers, lists and constructors of them."""
    found: list[tuple[int, int]] = []
    stack: list[tuple[int, str]] = []
    for match in re.finditer(r"[{}\[\]();]", text):
        sign, at = match.group(), match.start()
        if sign in _CLOSING:
            stack.append((at, sign))
        elif sign != ";" and stack and _CLOSING[stack[-1][1]] == sign:
            start = stack.pop()[0]
            if not re.search(r"[;=]", text[start:at]):
                found.append((start, at + 1))
    # Of lists in one another, the outermost.
    found.sort(key=lambda ends: (ends[0], -ends[1]))
    outer: list[tuple[int, int]] = []
    for ends in found:
        if not outer or ends[1] > outer[-1][1]:
            outer.append(ends)
    return outer


def _numbers(piece: str) -> np.ndarray:
    words = _NUMBER.findall(_WORD.sub(" ", piece))
    if len(words) > MOST_NUMBERS:
        raise InputError(f"it has a list of {len(words)} numbers")
    return np.array([float.fromhex(w) if "x" in w.lower() else float(w) for w in words])


def _shaped(piece: str, numbers: np.ndarray) -> np.ndarray:
    """Numbers in the shape that the lists within a list tell."""
    rows: list[int] = []
    depth = count = 0
    inner: list[int] = []
    for match in re.finditer(r"[{\[(}\])]|" + _NUMBER.pattern, _WORD.sub(" ", piece)):
        sign = match.group()
        if sign in _CLOSING:
            depth += 1
            if depth == 2:
                count, inner = 0, []
            start = count
        elif sign in "}])":
            if depth == 3:
                inner.append(count - start)
            if depth == 2:
                rows.append(count)
            depth -= 1
        else:
            count += 1
    if len(rows) < 2 or len(set(rows)) > 1 or sum(rows) != numbers.size:
        return numbers
    shape = [len(rows), rows[0]]
    if inner and len(set(inner)) == 1 and sum(inner) == rows[-1]:
        shape = [len(rows), rows[0] // inner[0], inner[0]]
    return numbers.reshape(shape)


def _exr(path: Path) -> np.ndarray:
    from albedo.lookup.formats.exr import library

    exr = library()
    try:
        with exr.File(str(path), header_only=True) as file:
            corner, far = (np.asarray(c).tolist() for c in file.header()["dataWindow"])
        if (far[0] - corner[0] + 1) * (far[1] - corner[1] + 1) > MOST_NUMBERS:
            raise InputError("its picture is too large")
        with exr.File(str(path), separate_channels=True) as file:
            found = {name: own.pixels for name, own in file.channels().items()}
    except InputError:
        raise
    except (RuntimeError, OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"it is no OpenEXR picture: {error}") from None
    order = [name for name in ("Y", "R", "G", "B", "A") if found.get(name) is not None]
    if not order:
        raise InputError("its picture has none of the channels Y, R, G, B, A")
    return _squeezed(np.stack([found[name] for name in order], axis=-1))


def _png(path: Path) -> np.ndarray:
    from PIL import Image

    try:
        with Image.open(path, formats=["PNG"]) as picture:
            if math.prod(picture.size) > MOST_NUMBERS:
                raise InputError("its picture is too large")
            wide = picture.mode in ("I;16", "I")
            own = picture if picture.mode in ("L", "LA", "RGB", "RGBA", "I;16", "I") else None
            data = np.asarray(own if own is not None else picture.convert("RGBA"))
    except InputError:
        raise
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise InputError(f"it is no PNG: {error}") from None
    return _squeezed(data / (65535.0 if wide else 255.0))


# Formats of DXGI, and four characters, whose pixels are plain numbers: type, channels, shares of.
_PLAIN = {
    2: ("<f4", 4, 1.0),
    6: ("<f4", 3, 1.0),
    10: ("<f2", 4, 1.0),
    11: ("<u2", 4, 65535.0),
    16: ("<f4", 2, 1.0),
    28: ("u1", 4, 255.0),
    29: ("u1", 4, 255.0),
    34: ("<f2", 2, 1.0),
    35: ("<u2", 2, 65535.0),
    41: ("<f4", 1, 1.0),
    49: ("u1", 2, 255.0),
    54: ("<f2", 1, 1.0),
    56: ("<u2", 1, 65535.0),
    61: ("u1", 1, 255.0),
}
_FOURCC = {36: 11, 111: 54, 112: 34, 113: 10, 114: 41, 115: 16, 116: 2}


def _dds(path: Path) -> np.ndarray:
    """The largest level of an uncompressed texture of DirectDraw."""
    data = path.read_bytes()
    if len(data) < 128 or data[:4] != b"DDS ":
        raise InputError("it is no DDS")
    height, width = struct.unpack_from("<II", data, 12)
    flags, code, bits = struct.unpack_from("<III", data, 80)
    start = 128
    if code == int.from_bytes(b"DX10", "little"):
        if len(data) < 148:
            raise InputError("it ends before its pixels")
        (number,) = struct.unpack_from("<I", data, 128)
        start = 148
    elif flags & 4:
        number = _FOURCC.get(code, 0)
    else:
        number = {8: 61, 16: 49, 32: 28}.get(bits, 0)
    if number not in _PLAIN:
        raise InputError("its pixels are compressed, or of a kind that is not read")
    kind, channels, whole = _PLAIN[number]
    count = height * width * channels
    if not 0 < count <= MOST_NUMBERS or len(data) - start < count * np.dtype(kind).itemsize:
        raise InputError(f"it does not hold {height} x {width} pixels")
    found = np.frombuffer(data, dtype=kind, count=count, offset=start).astype(np.float64) / whole
    if number == 28 and not flags & 4:
        # Red stands where its mask says.
        (red,) = struct.unpack_from("<I", data, 92)
        if red == 0x00FF0000:
            found = found.reshape(-1, 4)[:, [2, 1, 0, 3]].ravel()
    return _squeezed(found.reshape(height, width, channels))


def _squeezed(pixels: np.ndarray) -> np.ndarray:
    """Without channels that say nothing: copies of the first one, and ends that are constant."""
    if pixels.ndim == 2:
        return pixels
    kept = [0]
    for k in range(1, pixels.shape[-1]):
        own = pixels[..., k]
        copy = any(np.array_equal(own, pixels[..., j]) for j in kept)
        if not copy and np.ptp(own) > 0.0:
            kept.append(k)
    return pixels[..., 0] if len(kept) == 1 else pixels[..., kept]


_READERS: dict[str, Callable[[Path], Any]] = {
    ".npy": _npy,
    ".csv": _rows,
    ".txt": _rows,
    ".exr": _exr,
    ".png": _png,
    ".dds": _dds,
    **dict.fromkeys(
        (".h", ".hpp", ".inl", ".c", ".cpp", ".glsl", ".hlsl", ".js", ".mjs", ".ts", ".py", ".rs"),
        _source,
    ),
}
