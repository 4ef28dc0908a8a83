"""Pictures for sites: small, and the same to the eye."""

from __future__ import annotations

import base64
import io
import math
import re
from xml.etree import ElementTree

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from PIL import Image

from albedo import plotting
from albedo.compact import compact_svg, write_png


def curves(count: int) -> list[plotting.Curve]:
    """Curves that cost nothing."""
    cos_theta = plotting.angle_grid()
    error = np.full(cos_theta.shape, 0.01)
    return [
        plotting.Curve(f"ward:m={k}", "ward", cos_theta, cos_theta / k, error)
        for k in range(1, count + 1)
    ]


def test_pictures_for_a_site_are_small_and_say_the_same(tmp_path):
    figure = plotting.draw(curves(2), grazing=True)
    figure.axes[0].text(0.1, 0.1, "0.695707244(2)")
    plain = plotting.save_figure(plotting.draw(curves(2)), tmp_path / "plain.svg")
    plotting.save_for_site(figure, tmp_path / "site")
    text = (tmp_path / "site.svg").read_text()
    assert len(text) < 0.7 * len(plain.read_text())
    # Text is text, with its digits; coordinates are hundredths of a point; powers need no formula.
    for words in ("0.695707244(2)", "directional albedo", "ward:m=1", "10⁻²"):
        assert words in text
    assert not re.search(r"<path [^>]*\d\.\d{4,}", text)
    names = set(re.findall(r'class="(\w+)"', text))
    assert names
    assert all(f".{name}{{" in text for name in names)
    for target in re.findall(r'(?:url\(|href=")#([\w-]+)', text):
        assert f'id="{target}"' in text
    figure.set_dpi(192)
    canvas = FigureCanvasAgg(figure)
    with plotting.style():
        canvas.draw()
    all_colors = np.asarray(canvas.buffer_rgba())[..., :3]
    with Image.open(tmp_path / "site.png") as few:
        assert few.mode == "P"
        assert few.size == all_colors.shape[1::-1]
        # Twice the dots of a screen.
        assert np.allclose(few.info["dpi"], 192, atol=0.1)
        off = np.asarray(few.convert("RGB"), float) - all_colors
        assert np.sqrt(np.mean(off**2)) < 2.0
    assert not [path for path in tmp_path.iterdir() if path.suffix not in (".png", ".svg")]


def absolute(path: str) -> list[tuple[str, list[float]]]:
    """The commands of a path of an SVG, and their points."""
    pairs = {"m": 1, "l": 1, "q": 2, "c": 3, "z": 0}
    words = re.findall(r"[MLQCmlqczZ]|-?(?:\d+\.?\d*|\.\d+)(?:e-?\d+)?", path)
    found: list[tuple[str, list[float]]] = []
    at, letter, here, first = 0, "", [0.0, 0.0], [0.0, 0.0]
    while at < len(words):
        if words[at].isalpha():
            letter, at = words[at], at + 1
        count = 2 * pairs[letter.lower()]
        points = [float(word) for word in words[at : at + count]]
        at += count
        if letter in "lqc":
            points = [value + here[k % 2] for k, value in enumerate(points)]
        here = points[-2:] or first
        first = here if letter == "M" else first
        found.append((letter.lower(), points))
    return found


def drawing() -> Figure:
    """Lines of many points, curves, closed shapes, and maps with and without a rim."""
    x = np.linspace(0.0, 1.0, 500)
    with plotting.style():
        figure, (left, middle, right) = plotting.new_figure(3, 9.0, 3.0)
        left.plot(x, np.sin(40.0 * x) * np.exp(-5.0 * x))
        left.fill_between(x, x, x * x, alpha=0.3)
        left.add_patch(Circle((0.5, 0.0), 0.4, fill=False))
        middle.imshow(np.outer(x, x), extent=(0.0, 1.0, 0.0, 1.0), cmap="viridis")
        turn = np.linspace(0.0, 2.0 * math.pi, 97)
        across, along = np.outer(x[::20], np.cos(turn)), np.outer(x[::20], np.sin(turn))
        shade = across[:-1, :-1]
        right.pcolormesh(across, along, shade, rasterized=True)
    return figure


def test_compact_drawings_are_the_same_drawings(tmp_path):
    figure = drawing()
    with plotting.style(), rc_context({"svg.fonttype": "none"}):
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        figure.savefig(tmp_path / "plain.svg", metadata={"Date": None}, dpi=120)
    plain = (tmp_path / "plain.svg").read_text()
    short = compact_svg(plain)
    assert len(short) < 0.5 * len(plain)
    before, after = ElementTree.fromstring(plain), ElementTree.fromstring(short)
    # Only what says nothing is left out.
    for kind in ("path", "text", "use", "image", "clipPath"):
        name = f"{{http://www.w3.org/2000/svg}}{kind}"
        assert len(list(before.iter(name))) == len(list(after.iter(name)))
    name = "{http://www.w3.org/2000/svg}path"
    for old, new in zip(before.iter(name), after.iter(name), strict=True):
        commands, others = absolute(old.get("d")), absolute(new.get("d"))
        assert [c for c, _ in commands] == [c for c, _ in others]
        # Rounded to hundredths once, not once a step.
        for (_, points), (_, rounded) in zip(commands, others, strict=True):
            assert np.allclose(points, rounded, rtol=0.0, atol=0.0051)


def test_pictures_inside_of_drawings_keep_their_rim_and_colours(tmp_path):
    plotting.save_for_site(drawing(), tmp_path / "site")
    text = (tmp_path / "site.svg").read_text()
    inside = re.findall(r'base64,([^"]*)"', text)
    assert len(inside) == 2
    pictures = [Image.open(io.BytesIO(base64.b64decode(encoded))) for encoded in inside]
    assert [picture.mode for picture in pictures] == ["P", "P"]
    full, round_one = (np.asarray(picture.convert("RGBA")) for picture in pictures)
    assert np.all(full[..., 3] == 255)
    rim, rows = round_one[..., 3], round_one.shape[0]
    assert rim[0, 0] == rim[-1, -1] == 0
    assert rim[rows // 2, rows // 2] == 255
    # A disk in its square.
    assert abs(np.mean(rim > 0) - math.pi / 4.0) < 0.03
    # With an image, shades are not reduced to steps.
    with Image.open(tmp_path / "site.png") as picture:
        assert len(picture.getcolors()) > 128


def test_what_is_half_clear_is_not_made_opaque():
    def embedded(opacity: np.ndarray) -> str:
        """A picture of shades with an opacity, in an SVG."""
        shades = np.zeros((*opacity.shape, 4), dtype=np.uint8)
        shades[..., :3] = np.random.default_rng(0).integers(0, 256, (*opacity.shape, 3))
        shades[..., 3] = opacity
        file = io.BytesIO()
        Image.fromarray(shades).save(file, format="PNG")
        code = base64.b64encode(file.getvalue()).decode("ascii")
        return f'<svg><style></style><image href="data:image/png;base64,{code}"/></svg>'

    faint = embedded(np.full((64, 64), 100))
    assert compact_svg(faint) == faint
    disc = np.zeros((64, 64))
    disc[8:56, 8:56] = 255
    disc[8, 8:56] = 100
    shorter = compact_svg(embedded(disc))
    assert len(shorter) < len(embedded(disc))
    found = re.search(r"base64,([^\"]*)", shorter)
    assert found is not None
    with Image.open(io.BytesIO(base64.b64decode(found[1]))) as picture:
        seen = np.asarray(picture.convert("RGBA"))[..., 3]
    # A rim is there or not.
    np.testing.assert_array_equal(seen, np.where(disc == 255, 255, 0))


def test_no_shade_of_a_picture_is_passed_over(tmp_path):
    """A palette of few colours by their number alone would spend none on what is rare."""
    shades = np.full((300, 300, 4), 255, dtype=np.uint8)
    ramp = np.linspace(0.0, 255.0, 300)
    shades[:, :, 0], shades[:, :, 1] = ramp[:, None], ramp[None, :] ** 2 / 255.0
    shades[0, :40, 2] = np.arange(40) * 6
    write_png(shades, tmp_path / "small.png", 192, small=True)
    write_png(shades, tmp_path / "whole.png", 192, small=False)
    with Image.open(tmp_path / "whole.png") as whole, Image.open(tmp_path / "small.png") as small:
        np.testing.assert_array_equal(np.asarray(whole), shades[..., :3])
        assert small.mode == "P"
        off = np.abs(np.asarray(small.convert("RGB"), float) - shades[..., :3])
    # 256 cells in a cube of 255: a side of 40, and a little more where colours are few.
    assert off.max() <= 60.0


def test_pictures_of_a_quick_run_are_written_as_they_are(tmp_path):
    figure = plotting.draw(curves(2))
    plotting.save_for_site(figure, tmp_path / "quick", small=False)
    with Image.open(tmp_path / "quick.png") as picture:
        assert picture.mode == "RGB"
