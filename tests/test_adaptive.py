"""The integrator alone, on a unit square: what moved, what is refined, what cannot be seen."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from albedo import model
from albedo.brdf import Model
from albedo.charts.cosine import CosineChart
from albedo.integrators import adaptive
from albedo.integrators.adaptive import Result, integrate
from albedo.integrators.cells import Cells, ModelIntegrand, evaluate

Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Square:
    """A chart whose coordinates are those of the plane; wo carries them."""

    def panels(
        self,
        cos_theta: np.ndarray,
        phi: object,
        widths: object,
        isotropic: bool,
        coarse: bool = False,
        fine: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        n = cos_theta.size
        box = np.tile([0.0, 1.0, 0.0, 1.0], (n, 1))
        return np.empty((n, 0)), np.arange(n), np.ones((n, 4), dtype=int), box

    def nodes(
        self, geometry: np.ndarray, code: np.ndarray, box: np.ndarray, u: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        m, count = box.shape[0], u.size * v.size
        wide, high = box[:, 1] - box[:, 0], box[:, 3] - box[:, 2]
        wo = np.zeros((3, m, count))
        wo[0] = np.repeat(box[:, :1] + wide[:, None] * u, v.size, axis=1)
        wo[1] = np.tile(box[:, 2:3] + high[:, None] * v, (1, u.size))
        weight = np.repeat((wide * high)[:, None], count, axis=1)
        return np.ones((3, m)), wo, np.ones_like(wo), weight


def over_square(
    surface: Surface, rtol: float = 1e-8, limit: int = 400_000, per_panel: int = 0
) -> Result:
    return integrate(
        *(Square(), lambda row, wi, wo, h: surface(wo[0], wo[1]), np.ones(1), np.zeros(1)),
        *(np.ones((1, 2)), True),
        rtol=rtol,
        atol=0.0,
        limit=limit,
        per_panel=per_panel,
    )


def test_rows_may_have_evaluations_for_each_of_their_panels() -> None:
    few, more = (
        over_square(np.maximum, 1e-5, limit=5_000, per_panel=some) for some in (0, 200_000)
    )
    assert not few.converged.any()
    assert few.evaluations.max() <= 5_000
    assert more.converged.all()
    assert 5_000 < more.evaluations.max() <= 200_000
    for found in (few, more):
        assert np.all(np.abs(found.value - 2.0 / 3.0) <= found.error)


@pytest.mark.parametrize("rtol", [1e-3, 1e-8, 1e-12])
@pytest.mark.parametrize(
    ("surface", "exact"),
    [
        (lambda u, v: np.exp(u - v), (math.e - 1.0) * (1.0 - 1.0 / math.e)),
        (
            lambda u, v: 1.0 / (u + v + 0.01),
            2.01 * math.log(2.01) - 2.02 * math.log(1.01) + 0.01 * math.log(0.01),
        ),
        (lambda u, v: np.sqrt(u) * np.cbrt(v), 0.5),
        (lambda u, v: np.abs(u - 0.3141) * v, 0.25 * (0.3141**2 + 0.6859**2)),
        (lambda u, v: np.maximum(u, v), 2.0 / 3.0),
        (lambda u, v: np.exp(-(((u - 0.7) ** 2 + (v - 0.2) ** 2) / 1e-4)), math.pi * 1e-4),
    ],
    ids=["exponential", "pole", "roots", "kink", "diagonal kink", "spike"],
)
def test_bounds_hold_on_the_square(surface: Surface, exact: float, rtol: float) -> None:
    found = over_square(surface, rtol, 4_000_000)
    # The spike's tails beyond the square weigh 1e-174; the closed forms cancel a digit.
    assert abs(found.value[0] - exact) <= found.error[0] + 1e-15 * max(exact, 0.1)
    # A kink across all cells costs too much for the last digits, and says so.
    assert found.converged[0] == (found.error[0] <= rtol * abs(found.value[0]))
    if rtol > 1e-12:
        assert found.converged[0]


def test_a_cell_that_one_node_sees_has_no_bound() -> None:
    """All of a spike at a corner but its foot is between the first node and the edge."""

    def corner(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.exp(-300.0 * (u + v))

    found = over_square(corner, limit=64)
    exact = 1.0 / 300.0**2
    assert not found.converged[0]
    assert found.value[0] < 0.1 * exact
    assert found.error[0] >= exact


def test_what_moved_is_zero_where_nothing_moved(rng: np.random.Generator) -> None:
    """Moments of halves add up to those of the whole, for polynomials that all rules integrate."""
    p = np.polynomial.Polynomial(rng.standard_normal(5))
    q = np.polynomial.Polynomial(rng.standard_normal(5))
    chart = Square()
    geometry, row, code, box = chart.panels(np.ones(3), None, None, True)
    cells = Cells.blank(row, code, box, np.full((3, 2), 8))

    def surface(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        return p(wo[0]) * q(wo[1])

    evaluate(chart, surface, geometry, cells)
    work = adaptive._Work(np.arange(3), np.full((3, 2), 8), np.array([-1, 0, 1]))
    children = work.children(cells)
    evaluate(chart, surface, geometry, children)

    def moved(k: int, other: int) -> float:
        cut = int(work.cut[k])
        return adaptive._distance(k, other, cut, False, children.moments, cells.moments[k])

    # Sums of 64 terms of size one, and a matrix of four.
    assert max(moved(0, -1), moved(1, 3), moved(2, 4)) <= 1e-13
    children.moments[1, 0, 2] += 1e-6
    assert moved(1, 3) > 1e-8


def test_a_bound_that_was_passed_raises_the_doubt() -> None:
    cells = Cells.blank(
        *(np.zeros(1, dtype=int), np.ones((1, 4), dtype=int)),
        *(np.array([[0.0, 1.0, 0.0, 1.0]]), np.full((1, 2), 8)),
    )
    cells.value[:], cells.size[:], cells.error[:] = 1.0, 1.0, 1e-9
    work = adaptive._Work(np.zeros(1, dtype=int), np.full((1, 2), 16), np.array([-1]))
    children = work.children(cells)
    children.value[:], children.size[:] = 1.0 + 2e-8, 1.0
    children.moments[:, :, 0] = 2e-8
    doubt = np.ones(1)
    adaptive._audit(cells, children, work, doubt, np.zeros(1, dtype=bool))
    # The value moved ten times farther than the 2e-9 that both directions allowed.
    assert doubt[0] == pytest.approx(10.0, rel=1e-3)
    # A geometric fall makes 4e-16 of 2e-8 when the order doubles: eight times of that is the least.
    assert children.error[0].sum() == pytest.approx(8 * 2e-8 * 2e-8, rel=1e-9)


def test_a_faint_row_converges_beside_a_bright_one() -> None:
    """Errors of one row are nothing beside those of another, and must be refined all the same."""
    scale = np.array([1.0, 1e-30, 1e20, 1e-200])

    def integrand(row: np.ndarray, wi: np.ndarray, wo: np.ndarray, h: np.ndarray) -> np.ndarray:
        return scale[row, None] * np.exp(-30.0 * wo[0] ** 2)

    found = integrate(
        CosineChart(),
        integrand,
        *(np.full(4, 0.5), np.zeros(4), np.ones((4, 2)), True),
        rtol=1e-10,
        atol=0.0,
        limit=100_000,
    )
    assert np.all(found.converged)
    assert len(set(found.evaluations.tolist())) == 1


@pytest.mark.parametrize("fixed", ["light", "view"])
@pytest.mark.parametrize(
    "m",
    [
        model("cook_torrance", m=0.2, distribution="ggx", geometry="smith_correlated"),
        model("ward_duer", alpha_x=0.05, alpha_y=0.4),
        model("max_phong", n=40.0),
        model("oren_nayar_full", sigma=1.2, rho=0.05),
        model("lafortune", lobes=((-0.9, -0.8, 0.7, 12.0), (0.6, 0.7, 0.7, 3.0))),
        model("poulin_fournier"),
        model("stam_grating", coherence=10.0),
    ],
    ids=lambda value: value.name if isinstance(value, Model) else value,
)
def test_one_kernel_for_a_round_equals_block_by_block(m: Model, fixed: str) -> None:
    """Nodes and values are the same machine code, so that values agree to the last bit."""
    cosines, turns = np.array([0.9, 0.3, 1e-3]), np.array([0.4, 1.1, 0.0])
    for part in m.parts():
        p = part.packed(np.tile(np.array(m.pack(), dtype=float), (3, 1)))
        inside = ModelIntegrand(part.fill, p, np.array([1.0, 0.5, 3.0]), fixed == "view")

        def outside(
            row: np.ndarray,
            wi: np.ndarray,
            wo: np.ndarray,
            h: np.ndarray,
            f: ModelIntegrand = inside,
        ) -> np.ndarray:
            return f(row, wi, wo, h)

        one, two = (
            integrate(
                *(part.chart, f, cosines, turns, np.tile(part.widths, (3, 1)), m.isotropic),
                rtol=1e-7,
                atol=1e-280,
                limit=20_000,
            )
            for f in (inside, outside)
        )
        np.testing.assert_array_equal(one.value, two.value)
        np.testing.assert_array_equal(one.error, two.error)
        np.testing.assert_array_equal(one.evaluations, two.evaluations)
