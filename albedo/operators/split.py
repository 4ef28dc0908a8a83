"""Any chart with its panels cut where a divisor has kinks.

A kink of the divisor is a curve on the hemisphere that no chart knows. On every line of constant u
of a panel it is a place in v: the lines are cut there, and a panel is cut in u wherever the number
of places on its lines changes. What is left has the kinks along its edges, and is smooth. Between
two cuts a place is a smooth function of u, and kept as a Chebyshev series: where that is a little
wrong, panels still cover the same, and the kink lies a little beside their edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from albedo._compile import address, indirect, kernel
from albedo.charts._compiled import CompiledChart, clustered
from albedo.charts.heights import LOWEST, unfold
from albedo.integrators.cells import NODES_TYPES
from albedo.operators.maps import BENT_TERMS, Maps, albedos_at, changes_at
from albedo.operators.roots import next_share

_lay_out = indirect(NODES_TYPES)

# Lines are looked at in so many places, the first and the last of them so near to the ends.
_LOOKS, _NEAR = 15, 1e-4
# Lines of a panel, bisections between two that differ, and most panels that one is cut into.
_LINES, _BISECTIONS, _PIECES = 15, 26, 64
# Lines that a series is made of. It may be wrong by so much: that of a kink beside the edge is the
# square. A panel is cut for it until it is so short. One that is wrong by more is not used.
_TERMS, _BESIDE, _SHORTEST, _ASTRAY = BENT_TERMS, 1e-5, 1e-3, 1e-3
# Lines this near to the ends of a piece may have lost a place.
_CLOSE_BY = 1e-5
_NODES = np.polynomial.chebyshev.chebpts1(_TERMS)
_TO_SERIES = np.linalg.inv(np.polynomial.chebyshev.chebvander(_NODES, _TERMS - 1))
# What a pattern counts up to, of one function.
_POSITIVE = 8
# More kinks than this on one line are left to the integrator.
_MOST = 12
_ROOT_STEPS, _CLOSE = 60, 1e-10
_CLOSER = 8
# A kink that changes less than this, relatively, is none; nor is one in what tables err by.
_WEAK, _NOISE = 1e-7, 0.25


_NO_LEVELS = np.empty(0)


def weakest(maps: Maps) -> float:
    """What a kink changes at least."""
    return max(_WEAK, _NOISE * max(maps.errors, default=0.0))


@dataclass(frozen=True)
class Piece:
    """What lies in a rectangle between two curves.

    Attributes
    ----------
    rectangle : int
        Its number.
    start, end : float
        Of its width.
    ends : int
        At which of them lines are clustered; see `albedo.charts._compiled.clustered`.
    lower, upper : ndarray, shape (16,)
        Chebyshev series along the lines, for the share of the height at which it begins and ends.
    """

    rectangle: int
    start: float
    end: float
    ends: int
    lower: np.ndarray
    upper: np.ndarray


def cut_along(maps: Maps, levels: np.ndarray, box: np.ndarray, warp: np.ndarray) -> list[Piece]:
    """Cut rectangles of (w, y) where albedos have some levels.

    Parameters
    ----------
    maps : Maps
        As many albedos as there are levels; no control.
    levels : ndarray, shape (m,)
        Logarithms.
    box : ndarray, shape (n, 4)
        Ends in y and in w; see `albedo.operators.maps`.
    warp : ndarray, shape (n,)
        The k^2 of their w; 0 where w is the azimuth.

    Returns
    -------
    list of Piece
        In order, along w and then along y.
    """
    n = len(box)
    box = np.column_stack((box[:, 2:], box[:, :2], warp))
    base = address(_rectangles, NODES_TYPES), np.zeros(1)
    panels = np.zeros((n, 1)), np.arange(n), np.zeros((n, 1), dtype=np.int64), box
    room = 64 * n
    while True:
        row, code = np.empty(room, int), np.empty((room, 2), int)
        found = np.empty((room, box.shape[1] + 4 + 2 * _TERMS))
        count = _split(
            *(base, *panels, False, *maps.known, maps.code, levels.size, levels),
            *(weakest(maps), row, code, found),
        )
        if count >= 0:
            break
        room *= 2
    width = box.shape[1]
    pieces = []
    for k in range(count):
        first, last, w_0, w_1 = *found[k, width : width + 2], *box[row[k], :2]
        lower, upper = found[k, width + 4 :].reshape(2, _TERMS)
        start, end = (first - w_0) / (w_1 - w_0), (last - w_0) / (w_1 - w_0)
        pieces.append(Piece(int(row[k]), start, end, int(code[k, 1]), lower, upper))
    # Those of one range of w are in order.
    return sorted(pieces, key=lambda piece: (piece.rectangle, piece.start))


@kernel
def _rectangles(geometry, code, box, u, v, numbers, wi, wo, h, weight):
    """Directions of places in rectangles of (w, y)."""
    for k in range(box.shape[0]):
        warp = box[k, 4]
        for iu in range(u.size):
            w = box[k, 0] + (box[k, 1] - box[k, 0]) * u[iu]
            if warp > 0.0:
                x, y = math.sqrt(0.5 * (1.0 - w)), math.sqrt(0.5 * warp * (1.0 + w))
            else:
                x, y = math.cos(w), math.sin(w)
            norm = math.sqrt(x * x + y * y)
            for iv in range(v.size):
                c, s = unfold(box[k, 2] + (box[k, 3] - box[k, 2]) * v[iv])
                i = iu * v.size + iv
                wo[0, k, i] = s * x / norm
                wo[1, k, i] = s * y / norm
                wo[2, k, i] = c


@dataclass(frozen=True)
class SplitChart:
    """A chart with the kinks of a divisor as ends of panels.

    Parameters
    ----------
    chart : CompiledChart
        Whose panels are cut.
    maps : Maps
        The divisor.
    """

    chart: CompiledChart
    maps: Maps

    def panels(
        self,
        cos_theta: np.ndarray,
        phi: np.ndarray,
        widths: np.ndarray,
        isotropic: bool,
        coarse: bool = False,
        fine: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Panels of every row; see `albedo.charts.polar.PolarChart.panels`.

        Codes have one more column: at which ends in u nodes are clustered. Boxes have more, the
        ends of what was cut, and two series in u for the ends of its lines; the first four are
        shares of it.
        """
        chart: Any = self.chart
        geometry, row, code, box = chart.panels(cos_theta, phi, widths, isotropic, coarse, fine)
        room = 8 * row.size + 64
        while True:
            new = np.empty(room, int), np.empty((room, code.shape[1] + 1), int)
            boxes = np.empty((room, box.shape[1] + 4 + 2 * _TERMS))
            count = _split(
                *(self._base, geometry, row, code, box, coarse, *self.maps.known),
                *(self.maps.code, self.maps.changes, _NO_LEVELS, self._weak, *new, boxes),
            )
            if count >= 0:
                return geometry, new[0][:count], new[1][:count], boxes[:count]
            room *= 2

    @property
    def _weak(self) -> float:
        return weakest(self.maps)

    @property
    def _base(self) -> tuple[int, np.ndarray]:
        lay_out, numbers = self.chart.layout
        return address(lay_out, NODES_TYPES), numbers

    def nodes(
        self,
        geometry: np.ndarray,
        code: np.ndarray,
        box: np.ndarray,
        u: np.ndarray,
        v: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Directions and Jacobians; see `albedo.charts._compiled.CompiledChart.nodes`."""
        m, count = box.shape[0], u.size * v.size
        wo, h = np.empty((3, m, count)), np.empty((3, m, count))
        found = np.empty((3, m)), wo, h, np.empty((m, count))
        _nodes(self._base, geometry, code, box, u, v, *found)
        return found


@kernel
def _line(base, g, code, box, u, v, wi, wo, h, weight):
    """Nodes along one line of a panel."""
    _lay_out(base[0], (g, code, box, u, v, base[1], wi, wo, h, weight))


@kernel
def _signs(wi, wo, i, at_v, at_l, known, control, out):
    """The functions that change their signs, for V at a node of a line."""
    vz = max(wo[2, 0, i], LOWEST)
    albedos_at(wo[0, 0, i], wo[1, 0, i], wo[2, 0, i], *known, at_v)
    changes_at(at_l, at_v, max(wi[2, 0], LOWEST), vz, control, out)


@kernel
def _at(base, g, code, box, u, t, known, control, at_l, room, out):
    """Fill the functions that change their signs at one place of a line."""
    one, wi, wo, h, weight, at_v = room
    one[0] = t
    _line(base, g, code, box, u, one, wi, wo, h, weight)
    _signs(wi, wo, 0, at_v, at_l, known, control, out)


@kernel
def _keep(places, count, x):
    """Put a place among the others, which are in order; return their number."""
    if count >= _MOST:
        return count
    k = count
    while k > 0 and places[k - 1] > x:
        places[k] = places[k - 1]
        k -= 1
    places[k] = x
    return count + 1


@kernel
def _places(base, g, code, box, u, known, control, changes, at_l, weak, counting, places, ends):
    """Fill places in (0, 1) of a line where signs change, in order; return how many, and a pattern.

    The pattern tells how many are of which function, and its sign at the start: where a curve runs
    along a line, all of the line changes its sign. `ends` are filled with the least that the
    functions are away from 0 at both ends, and then the least that each is where it turns away from
    0 in between. Places are rough while they are only counted.
    """
    looks, wi = np.empty(_LOOKS), np.empty((3, 1))
    views, sums, weights = np.empty((3, 1, _LOOKS)), np.empty((3, 1, _LOOKS)), np.empty((1, _LOOKS))
    at_v, here, seen = np.empty(at_l.size), np.empty(changes), np.empty((changes, _LOOKS))
    one = np.empty(1), wi, np.empty((3, 1, 1)), np.empty((3, 1, 1)), np.empty((1, 1)), at_v
    for look in range(_LOOKS):
        # Closer at both ends, where places come and go.
        sine = math.sin(0.5 * math.pi * look / (_LOOKS - 1))
        looks[look] = min(max(sine * sine, _NEAR), 1.0 - _NEAR)
    _line(base, g, code, box, u, looks, wi, views, sums, weights)
    for look in range(_LOOKS):
        _signs(wi, views, look, at_v, at_l, known, control, here)
        for j in range(changes):
            seen[j, look] = here[j]
    count, pattern = 0, 0
    for i in range(ends.size):
        ends[i] = math.inf
    for j in range(changes):
        ends[0], ends[1] = min(ends[0], abs(seen[j, 0])), min(ends[1], abs(seen[j, _LOOKS - 1]))
        mark = 1 << (4 * min(j, 14))
        before = -1
        for i in range(_LOOKS):
            # What is weaker changes nothing that matters, however often.
            if abs(seen[j, i]) < weak:
                continue
            if before >= 0 and (seen[j, before] > 0.0) != (seen[j, i] > 0.0):
                a, b, fa, fb = looks[before], looks[i], seen[j, before], seen[j, i]
                x = 0.5 * (a + b)
                if not counting:
                    # A third look, beyond the side that the search sets out from.
                    c, fc = a, fa
                    if before > 0:
                        c, fc = looks[before - 1], seen[j, before - 1]
                    elif i + 1 < _LOOKS:
                        a, b, fa, fb = b, a, fb, fa
                        c, fc = looks[i + 1], seen[j, i + 1]
                    x = _root(
                        *(a, b, c, fa, fb, fc, j, base, g, code, box, u, known, control, at_l),
                        *(one, here),
                    )
                count = _keep(places, count, x)
                pattern += mark
            if before < 0 and seen[j, i] > 0.0:
                pattern += _POSITIVE * mark
            before = i
        for i in range(1, _LOOKS - 1):
            a, b, fa, fb = looks[i - 1], looks[i], seen[j, i - 1], seen[j, i]
            if (fa > 0.0) != (fb > 0.0):
                continue
            c, fc = looks[i + 1], seen[j, i + 1]
            if (fc > 0.0) != (fb > 0.0) or abs(fb) > min(abs(fa), abs(fc)):
                continue
            # A function that comes close to 0 and turns may have two places between three looks.
            fx = fb
            for turn in range(_CLOSER):
                left, right = (fb - fa) / (b - a), (fc - fb) / (c - b)
                bent = (right - left) / (c - a)
                x = 0.5 * (a + b) - 0.5 * left / bent
                low = fa + (x - a) * (left + (x - b) * bent)
                # The parabola is trusted from the second time on.
                far = turn > 1 and low * fb > 0.5 * fb * fb
                if not a < x < c or abs(x - b) < 1e-9 or far:
                    break
                _at(base, g, code, box, u, x, known, control, at_l, one, here)
                fx = here[j]
                if (fx > 0.0) != (fb > 0.0) and abs(fx) >= weak:
                    first, second = a, c
                    if not counting:
                        first = _root(
                            *(a, x, a, fa, fx, fa, j, base, g, code, box, u, known, control),
                            *(at_l, one, here),
                        )
                        second = _root(
                            *(x, c, x, fx, fc, fx, j, base, g, code, box, u, known, control),
                            *(at_l, one, here),
                        )
                    count = _keep(places, _keep(places, count, first), second)
                    pattern += 2 * mark
                    break
                if x < b:
                    if abs(fx) < abs(fb):
                        b, fb, c, fc = x, fx, b, fb
                    else:
                        a, fa = x, fx
                elif abs(fx) < abs(fb):
                    a, fa, b, fb = b, fb, x, fx
                else:
                    c, fc = x, fx
            if (fx > 0.0) == (fb > 0.0):
                ends[2 + j] = min(ends[2 + j], abs(fb))
    return count, pattern


@kernel
def _root(x_1, x_2, x_3, f_1, f_2, f_3, j, base, g, code, box, u, known, control, at_l, one, here):
    """The place between the first two where function j changes its sign.

    The third is on the side of the first, or the same.
    """
    best = x_1 if abs(f_1) < abs(f_2) else x_2
    for _ in range(_ROOT_STEPS):
        least = _CLOSE / max(abs(x_2 - x_1), 1e-300)
        if least > 0.5:
            break
        x = x_1 + next_share(x_1, x_2, x_3, f_1, f_2, f_3, least) * (x_2 - x_1)
        _at(base, g, code, box, u, x, known, control, at_l, one, here)
        fx = here[j]
        if (fx > 0.0) == (f_1 > 0.0):
            x_3, f_3 = x_1, f_1
        else:
            x_3, f_3, x_2, f_2 = x_2, f_2, x_1, f_1
        x_1, f_1 = x, fx
        best = x_1 if abs(f_1) < abs(f_2) else x_2
        if fx == 0.0:
            break
    return best


@kernel
def _base_of(code, box, k, code_1, box_1):
    """The panel that was cut, as its own chart knows it."""
    for j in range(code_1.shape[1]):
        code_1[0, j] = code[k, j]
    width = box_1.shape[1]
    for j in range(width):
        box_1[0, j] = box[k, j] if j >= 4 else box[k, width + j]


@kernel
def _split(base, geometry, row, code, box, coarse, *rest):
    """Fill row, code and box of what panels are cut into; return their number, or -1."""
    known, (control, changes, levels, weak, new_row, new_code, new_box) = rest[:11], rest[11:]
    at_l = np.empty(known[0].shape[0])
    one, wi = np.empty(1), np.empty((3, 1))
    wo, h, weight = np.empty((3, 1, 1)), np.empty((3, 1, 1)), np.empty((1, 1))
    # Pieces that wait: their ends in u, at which of them nodes are clustered, and their places.
    lows, highs, flags = np.empty(_PIECES), np.empty(_PIECES), np.empty(_PIECES, np.int64)
    kinds, patterns = np.empty(_PIECES, np.int64), np.empty(_PIECES, np.int64)
    curves = np.empty((_MOST + 2, _TERMS))
    columns, width = code.shape[1], box.shape[1]
    count = 0
    for k in range(row.size):
        g, code_1, box_1 = geometry[row[k] : row[k] + 1], code[k : k + 1], box[k : k + 1]
        one[0] = 0.5
        _line(base, g, code_1, box_1, one, one, wi, wo, h, weight)
        if levels.size == 0:
            albedos_at(wi[0, 0], wi[1, 0], wi[2, 0], *known, at_l)
        for j in range(levels.size):
            at_l[j] = levels[j]
        panel = base, g, code_1, box_1
        divisor = known, control, changes, at_l, weak
        lows[0], highs[0], flags[0], kinds[0], patterns[0], top = 0.0, 1.0, 0, 0, 0, 1
        if changes > 0 and not coarse:
            top = _cuts(panel, divisor, lows, highs, flags, kinds, patterns)
        made = top
        while top > 0:
            top -= 1
            low, high, ends = lows[top], highs[top], flags[top]
            kind, pattern = kinds[top], patterns[top]
            rough, before, after = _curves(panel, divisor, low, high, ends, kind, pattern, curves)
            if before < after and made < _PIECES:
                # Between two of its lines places come or go.
                x, inside, other = _change(panel, divisor, before, after, pattern)
                highs[top], flags[top] = x, ends | 2
                lows[top + 1], highs[top + 1], flags[top + 1] = x, high, ends | 1
                kinds[top + 1], patterns[top + 1] = inside, other
                top, made = top + 2, made + 1
                continue
            if rough > _BESIDE and high - low > _SHORTEST and made < _PIECES:
                middle = 0.5 * (low + high)
                highs[top], flags[top] = middle, ends & 1
                lows[top + 1], highs[top + 1], flags[top + 1] = middle, high, ends & 2
                kinds[top + 1], patterns[top + 1] = kind, pattern
                top, made = top + 2, made + 1
                continue
            if before < after or rough > _ASTRAY:
                # Its kinks are left to the integrator.
                kind = 0
                _whole(curves)
            if count + kind + 1 > new_row.size:
                return -1
            size = box[k, 1] - box[k, 0]
            for part in range(kind + 1):
                new_row[count] = row[k]
                for i in range(columns):
                    new_code[count, i] = code[k, i]
                new_code[count, columns] = ends
                for i in range(width):
                    new_box[count, i] = box[k, i]
                for i in range(4):
                    new_box[count, i] = i % 2
                    new_box[count, width + i] = box[k, i]
                new_box[count, width] = box[k, 0] + low * size
                new_box[count, width + 1] = box[k, 0] + high * size
                for i in range(_TERMS):
                    new_box[count, width + 4 + i] = curves[part, i]
                    new_box[count, width + 4 + _TERMS + i] = curves[part + 1, i]
                count += 1
    return count


@kernel
def _lines(panel, divisor, lines, inside, patterns):
    """Fill lines of a panel, in order, and what is seen on them; return how many.

    A curve may close between two lines. So where a function comes closer to 0 than on both
    neighbours of a line, more lines go after it.
    """
    changes = divisor[2]
    places, away, one = np.empty(_MOST + 1), np.empty(2 + changes), np.empty(1)
    near = np.empty((_LINES, changes))
    for line in range(_LINES):
        # Closer to both ends, where no neighbour is beyond.
        share = (line - 0.5 * (line == 1) + 0.5 * (line == _LINES - 2)) / (_LINES - 1)
        one[0] = lines[line] = min(max(share, _NEAR), 1.0 - _NEAR)
        inside[line], patterns[line] = _places(*panel, one, *divisor, True, places, away)
        for j in range(changes):
            near[line, j] = away[2 + j]
    count = _LINES
    middles = lines[:_LINES].copy()
    seen = patterns[:_LINES].copy()
    for line in range(1, _LINES - 1):
        if seen[line - 1] != seen[line] or seen[line + 1] != seen[line]:
            continue
        for j in range(changes):
            a, b, c = middles[line - 1], middles[line], middles[line + 1]
            fa, fb, fc = near[line - 1, j], near[line, j], near[line + 1, j]
            if fb > min(fa, fc) or not fb < math.inf:
                continue
            for turn in range(_CLOSER):
                x, low = 0.5 * (b + (a if b - a > c - b else c)), -1.0
                if max(fa, fc) < math.inf:
                    left, right = (fb - fa) / (b - a), (fc - fb) / (c - b)
                    bent = (right - left) / (c - a)
                    x = 0.5 * (a + b) - 0.5 * left / bent
                    low = fa + (x - a) * (left + (x - b) * bent)
                if not a < x < c or abs(x - b) < 1e-6 or (turn > 1 and low > 0.5 * fb):
                    break
                one[0] = x
                found, pattern = _places(*panel, one, *divisor, True, places, away)
                if pattern != seen[line]:
                    if count < lines.size:
                        k = count
                        while lines[k - 1] > x:
                            lines[k], inside[k] = lines[k - 1], inside[k - 1]
                            patterns[k] = patterns[k - 1]
                            k -= 1
                        lines[k], inside[k], patterns[k] = x, found, pattern
                        count += 1
                    break
                fx = away[2 + j]
                if x < b:
                    if fx < fb:
                        b, fb, c, fc = x, fx, b, fb
                    else:
                        a, fa = x, fx
                elif fx < fb:
                    a, fa, b, fb = b, fb, x, fx
                else:
                    c, fc = x, fx
    return count


@kernel
def _cuts(panel, divisor, lows, highs, flags, kinds, patterns):
    """Fill pieces in u that differ in the number of places on their lines; return how many."""
    lines, inside = np.empty(2 * _LINES), np.empty(2 * _LINES, np.int64)
    seen = np.empty(2 * _LINES, np.int64)
    count = _lines(panel, divisor, lines, inside, seen)
    lows[0], flags[0], kinds[0], patterns[0], m = 0.0, 0, inside[0], seen[0], 1
    low = lines[0]
    for line in range(1, count):
        high = lines[line]
        while patterns[m - 1] != seen[line] and 2 * m < _PIECES:
            x, kind, other = _change(panel, divisor, low, high, patterns[m - 1])
            # Places come and go like roots, at the horizon and where two meet.
            highs[m - 1], flags[m - 1] = x, flags[m - 1] | 2
            lows[m], flags[m], kinds[m], patterns[m], low = x, 1, kind, other, x
            m += 1
        low = high
    highs[m - 1] = 1.0
    return m


@kernel
def _change(panel, divisor, low, high, pattern):
    """The first place in u that is found where a pattern ends, and what follows there."""
    places, away, one = np.empty(_MOST + 1), np.empty(2 + divisor[2]), np.empty(1)
    one[0] = high
    inside, other = _places(*panel, one, *divisor, True, places, away)
    a, b = low, high
    for _ in range(_BISECTIONS):
        one[0] = 0.5 * (a + b)
        found, seen = _places(*panel, one, *divisor, True, places, away)
        if seen == pattern:
            a = one[0]
        else:
            b, inside, other = one[0], found, seen
    return b, inside, other


@kernel
def _whole(curves):
    """Fill the series of a piece that is not cut."""
    for i in range(_TERMS):
        curves[0, i] = curves[1, i] = 0.0
    curves[1, 0] = 1.0


@kernel
def _curves(panel, divisor, low, high, ends, kind, pattern, curves):
    """Fill series for the places on the lines of a piece.

    Return how much they miss, and two lines between which places come or go: the same if none do.
    """
    for i in range(_TERMS):
        for j in range(kind + 2):
            curves[j, i] = 0.0
    curves[kind + 1, 0] = 1.0
    places, away, one = np.empty(_MOST + 1), np.empty(2 + divisor[2]), np.empty(1)
    before = low
    for i in range(_TERMS):
        t, _ = clustered(0.5 * (_NODES[i] + 1.0), ends)
        one[0] = low + t * (high - low)
        found, seen = _places(*panel, one, *divisor, kind == 0, places, away)
        if seen != pattern and _CLOSE_BY < t < 1.0 - _CLOSE_BY:
            return 0.0, before, one[0]
        before = one[0]
        # A place that left at an end is taken for that end.
        while found > kind:
            if places[0] < 1.0 - places[found - 1]:
                for j in range(found - 1):
                    places[j] = places[j + 1]
            found -= 1
        while found < kind:
            if away[0] < away[1]:
                for j in range(found, 0, -1):
                    places[j] = places[j - 1]
                places[0] = 0.0
            else:
                places[found] = 1.0
            found += 1
        for j in range(kind):
            for n in range(_TERMS):
                curves[j + 1, n] += _TO_SERIES[n, i] * places[j]
    rough = 0.0
    for j in range(1, kind + 1):
        rough = max(rough, abs(curves[j, _TERMS - 1]) + abs(curves[j, _TERMS - 2]))
    return rough, low, low


@kernel
def _place(series, first, t):
    """The value of a series at t in (0, 1), which begins in a row of numbers at `first`."""
    twice = 4.0 * t - 2.0
    total = last = 0.0
    for i in range(_TERMS - 1, 0, -1):
        total, last = twice * total + (series[first + i] - last), total
    return 0.5 * twice * total - last + series[first]


@kernel
def _nodes(base, geometry, code, box, u, v, wi, wo, h, weight):
    """Nodes of parts of lines; one row per panel."""
    columns, width, q = code.shape[1] - 1, box.shape[1] - 4 - 2 * _TERMS, v.size
    code_1, box_1 = np.empty((1, columns), np.int64), np.empty((1, width))
    one, along = np.empty(1), np.empty(q)
    wi_1, wo_1, h_1 = np.empty((3, 1)), np.empty((3, 1, q)), np.empty((3, 1, q))
    weight_1 = np.empty((1, q))
    for k in range(box.shape[0]):
        g = geometry[k : k + 1]
        _base_of(code, box, k, code_1, box_1)
        for iu in range(u.size):
            t = box[k, 0] + (box[k, 1] - box[k, 0]) * u[iu]
            one[0], turn = clustered(t, code[k, columns])
            turn *= box[k, 1] - box[k, 0]
            start = min(max(_place(box[k], width + 4, t), 0.0), 1.0)
            # Where series cross, parts are negative: together they cover a line once.
            end = min(max(_place(box[k], width + 4 + _TERMS, t), 0.0), 1.0)
            first, share = box[k, 2], box[k, 3] - box[k, 2]
            for iv in range(q):
                along[iv] = start + (end - start) * (first + share * v[iv])
            _line(base, g, code_1, box_1, one, along, wi_1, wo_1, h_1, weight_1)
            for i in range(3):
                wi[i, k] = wi_1[i, 0]
            for iv in range(q):
                j = iu * q + iv
                for i in range(3):
                    wo[i, k, j] = wo_1[i, 0, iv]
                    h[i, k, j] = h_1[i, 0, iv]
                weight[k, j] = weight_1[0, iv] * (end - start) * share * turn
