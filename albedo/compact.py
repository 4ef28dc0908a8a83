"""Pictures for sites of many figures: PNG and SVG in half the bytes, the same to the eye."""

from __future__ import annotations

import base64
import io
import os
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from PIL.Image import Image

__all__ = ["compact_svg", "write_png"]

# Of the dots of a picture that are not clear, those at its rim may be half clear.
_RIM = 0.1


def write_png(shades: np.ndarray, path: str | os.PathLike[str], dots: int, small: bool) -> None:
    """Write a picture as PNG.

    Parameters
    ----------
    shades : ndarray of uint8, shape (rows, columns, 4)
        Red, green, blue and opacity; the picture is opaque.
    path : path
        The file.
    dots : int
        Of an inch.
    small : bool
        With a palette of 256 colours that are chosen for it: half the bytes, ten times the time.
    """
    from PIL import Image

    plain = Image.fromarray(shades).convert("RGB")
    chosen = _few_colors(plain, 256) if small else plain
    chosen.save(path, format="PNG", compress_level=9 if small else 1, dpi=(dots, dots))


def _few_colors(plain: Image, count: int) -> Image:
    """With a palette that leaves no shade far from all of its colours, however rare it is."""
    from PIL import Image

    how = Image.Quantize.MAXCOVERAGE
    return plain.quantize(count, method=how, kmeans=1, dither=Image.Dither.NONE)


def compact_svg(text: str) -> str:
    """Shorten an SVG that matplotlib wrote.

    Coordinates are rounded to hundredths of a point and written from the last point on, styles
    are named once, pictures inside have a palette, and what says nothing is left out.

    Parameters
    ----------
    text : str
        The SVG.

    Returns
    -------
    str
        The same drawing.
    """
    # Only inside of tags: what lies between them is text that is read.
    text = re.sub(r"<[^>]*>", lambda tag: _COORDINATE.sub(_hundredths, tag[0]), text)
    text = re.sub(r"<!--.*?-->|<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r' d="([^"]*)"', lambda found: f' d="{_from_the_last(found[1])}"', text)
    text = re.sub(r"(?<=image/png;base64,)[^\"]*", lambda found: _with_palette(found[0]), text)
    referred = set(re.findall(r"#([\w.-]+)", text))
    text = re.sub(r'<g id="([^"]*)">', lambda m: m[0] if m[1] in referred else "<g>", text)
    text = "".join(_without_bare_groups(text))
    styles: dict[str, str] = {}

    def named(found: re.Match[str]) -> str:
        look = found[1].replace(": ", ":").replace("; ", ";")
        # Where that font is missing, one of nearly the same widths.
        look = look.replace("'DejaVu Sans'", "'DejaVu Sans',Verdana,sans-serif")
        return f'class="{styles.setdefault(look, f"s{len(styles)}")}"'

    text = re.sub(r'(?<=\s)style="([^"]*)"', named, text)
    rules = "".join(f".{name}{{{look}}}\n" for look, name in styles.items())
    text = text.replace("</style>", f"{rules}</style>", 1)
    return re.sub(r"\s*\n\s*", "\n", text)


_COORDINATE = re.compile(r"(?<![\w.])-?\d+\.\d{4,}(?![\w.])")
_STEP = re.compile(r"[MLQCz]|-?\d+(?:\.\d+)?")
_PAIRS = {"M": 1, "L": 1, "Q": 2, "C": 3}


def _hundredths(found: re.Match[str]) -> str:
    return f"{float(found[0]):.2f}"


def _from_the_last(path: str) -> str:
    """A path of absolute coordinates, in hundredths, as one of differences without drift."""
    steps = _STEP.findall(path.replace("Z", "z"))
    if re.sub(r"[\s,]", "", path.replace("Z", "z")) != "".join(steps):
        # Exponents, or commands that matplotlib does not use.
        return path
    written: list[str] = []
    last, x, y, start = "", 0, 0, (0, 0)
    at = 0
    while at < len(steps):
        command, at = steps[at], at + 1
        if command == "z":
            written.append("z")
            last, (x, y) = "z", start
            continue
        points = [round(100.0 * float(word)) for word in steps[at : at + 2 * _PAIRS[command]]]
        at += len(points)
        if command == "M":
            start = (points[0], points[1])
            words = "M" + _joined(points)
        else:
            moved = [value - (x, y)[index % 2] for index, value in enumerate(points)]
            words, letter = _joined(moved), command.lower()
            if letter != last:
                words = letter + words
            elif words[0] != "-":
                words = " " + words
        last, (x, y) = command.lower(), points[-2:]
        written.append(words)
    return "".join(written)


def _joined(hundredths: list[int]) -> str:
    """Numbers in a row; a minus sign parts them as well as a blank does."""
    plain = [f"{value / 100:.2f}".rstrip("0").rstrip(".") for value in hundredths]
    words = [re.sub(r"^(-?)0(?=\.)", r"\1", word) for word in plain]
    return words[0] + "".join(w if w[0] == "-" else f" {w}" for w in words[1:])


def _with_palette(encoded: str) -> str:
    """A PNG in base64 with 256 colours, if that is shorter; the rim is seen whole or not at all."""
    import numpy as np
    from PIL import Image

    with Image.open(io.BytesIO(base64.b64decode(encoded))) as image:
        full = image.convert("RGBA")
    opacity = full.getchannel("A")
    seen = np.asarray(opacity)[np.asarray(opacity) > 0]
    if np.count_nonzero(seen < 255) > _RIM * seen.size:
        # A palette has one clear colour, and none that is half clear.
        return encoded
    behind = Image.new("RGBA", full.size, "white")
    plain = Image.alpha_composite(behind, full).convert("RGB")
    few = _few_colors(plain, 255)
    more = {}
    if np.any(np.asarray(opacity) < 128):
        chosen = (few.getpalette() or [])[: 3 * 255]
        few.putpalette(chosen + [255] * (3 * 256 - len(chosen)))
        few.paste(255, mask=opacity.point(lambda level: 255 * (level < 128)))
        more = {"transparency": 255}
    kept = io.BytesIO()
    few.save(kept, format="PNG", compress_level=9, **more)
    shorter = base64.b64encode(kept.getvalue()).decode("ascii")
    return min(shorter, encoded, key=len)


def _without_bare_groups(text: str) -> Iterator[str]:
    """The text without groups that carry no attribute or hold nothing."""
    bare: list[bool] = []
    for part in re.split(r"(<g(?=[\s/>])[^>]*>|</g>)", text):
        if part == "</g>":
            if not bare.pop():
                yield part
        elif part.startswith("<g") and not part.endswith("/>"):
            bare.append(part == "<g>")
            if not bare[-1]:
                yield part
        elif not part.startswith("<g"):
            yield part
