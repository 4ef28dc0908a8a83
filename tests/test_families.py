"""Rows of families beside rows that are had from the model at the same incidences."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.polynomial.legendre import legval

import albedo
from albedo.brdf import Model, Part
from albedo.charts.heights import LAST, folded
from albedo.operators.families import Families
from albedo.operators.ladder import Ladder, _finest, rings_of
from albedo.operators.nodes import cosines
from albedo.operators.panels import _NOISE, Ahead, Panels, common

RTOL = 7.2e-12
SPECS = [
    "phong:n=1",
    "phong:n=20",
    "phong:n=1e6",
    "blinn",
    "ward:m=0.1",
    "ward:m=0.4",
    "cook_torrance",
    "cook_torrance:m=0.3",
    "cook_torrance:m=0.3,distribution=ggx",
    "cook_torrance:geometry=smith_rational",
    "distribution_brdf",
    "lafortune",
    "lafortune:lobes=((-1,0.3,1,20))",
    "lafortune:lobes=((-1,-1,-0.3,7.3))",
    "lafortune_scaled",
    "oren_nayar",
    "cook_torrance:m=0.3,fresnel=dielectric",
    "schlick",
    "max_phong:n=20,variant=retro",
]
# Enough rows for a family in every stretch of these.
Y = np.concatenate([np.linspace(a, b, 90) for a, b in ((-9.0, -3.0), (-3.0, 0.0))])
Y = np.concatenate((Y, np.linspace(0.0, LAST, 600)))


def families_of(part: Part, model: Model) -> Families:
    finest = _finest(part)
    return Families(model, part, rings_of(part), max(RTOL, finest), finest)


def numbered(profiles: Panels) -> np.ndarray:
    """The segment of each panel, counting through all rows."""
    key = np.column_stack((profiles.row, profiles.code[:, 0], profiles.box[:, 4]))
    return np.unique(key, axis=0, return_inverse=True)[1].ravel()


def compared(found: Panels, known: Panels) -> tuple[np.ndarray, np.ndarray]:
    """Differences of what rows hold above the parts of panels, and what their bounds grant."""
    groups = numbered(found), numbered(known)
    ends = [np.concatenate((found.box[:, column], known.box[:, column])) for column in (2, 3)]
    panel, of, starts, stops = common(np.concatenate(groups), *ends)
    t = starts[:, None] + np.linspace(0.0, 1.0, 33) * (stops - starts)[:, None]
    values, slack = np.zeros((2, *t.shape)), np.zeros(starts.size)
    for k, panels in enumerate((found, known)):
        first = k * found.row.size
        mine = (panel >= first) & (panel < first + panels.row.size)
        p, q = panel[mine] - first, of[mine]
        size = (panels.box[p, 3] - panels.box[p, 2])[:, None]
        x = 2.0 * (t[q] - panels.box[p, 2][:, None]) / size - 1.0
        # Series are per panel, not per segment.
        values[k, q] = legval(x.T, panels.series[p].T, tensor=False).T / size
        slack[q] += panels.doubt[panels.row[p]] * panels.blur[p] + panels.tail[p]
    rows = np.zeros(starts.size, int)
    rows[of] = np.concatenate((found.row, known.row))[panel]
    # Roundings at nodes are amplified by the degree in all series; an ulp of directions.
    slack += (_NOISE + found.shift[rows]) * np.abs(values[1]).max(1) * (stops - starts)
    # What a divisor can make of a difference is its modulus, added up.
    return np.abs(values[0] - values[1]).mean(1) * (stops - starts), slack


@pytest.mark.parametrize("spec", SPECS)
def test_densities_are_within_the_bounds_of_families(spec: str, rng: np.random.Generator) -> None:
    model = next(albedo.grammar.parse(spec).models())
    for part in model.parts():
        families = families_of(part, model)
        families.panels(cosines(Y))
        stretches = [s for s in families._stretches[None] if s.family is not None]
        assert stretches
        y = np.array([s.low + rng.uniform(size=4) * (s.high - s.low) for s in stretches]).ravel()
        c = cosines(y)
        found = families.panels(c)
        known = Panels.of(model, part, families.chart, c, max(RTOL / 100.0, families.finest))
        np.testing.assert_array_equal(found.geometry, known.geometry)
        worst, slack = compared(found, known)
        assert np.all(worst <= slack)


@pytest.mark.parametrize("spec", ["he_torrance", "distribution_brdf"])
def test_families_know_what_is_next_to_nothing(spec: str, rng: np.random.Generator) -> None:
    """Steps divide by small albedos time and again, so that what hardly counts will be much."""
    model = next(albedo.grammar.parse(spec).models())
    (part,) = model.parts()
    ahead = Ahead(Ladder(model, None, 1e-6).step())
    families = families_of(part, model)
    y = np.linspace(-11.0, -5.0, 120)
    families.panels(cosines(y), ahead)
    stretches = [s for s in families._stretches[ahead] if s.family is not None]
    assert len(stretches) >= 2
    y = np.array([s.low + rng.uniform(size=4) * (s.high - s.low) for s in stretches]).ravel()
    found = families.panels(cosines(y), ahead)
    assert np.all(found.ahead == 1)
    rtol = max(RTOL / 16.0, families.finest)
    known = Panels.of(model, part, families.chart, cosines(y), rtol, ahead)
    worst, slack = compared(found, known)
    assert np.all(worst <= slack)
    plain = Panels.of(model, part, families.chart, cosines(y), families.rtol)
    lost = []
    for rows in (found, plain):
        held = ahead.shares(rows.geometry, rows.code, rows.box, rows.row, rows.series[:, 0])
        lost.append(float((rows.doubt[rows.row] * rows.blur / held).max()))
    # Families may lose twice what is asked for at their nodes, and hardly more between them.
    assert lost[0] <= 3.0 * families.rtol
    assert lost[1] > 1e3 * lost[0]


def test_families_stand_for_the_model_where_many_rows_are_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No row that a family holds is had from the model, and rows stay in their order."""
    model = albedo.model("ward", m=0.1)
    (part,) = model.parts()
    families = families_of(part, model)
    few = cosines(np.linspace(-1.9, -1.1, 20))
    families.panels(few)
    # Few rows are no reason to make a family.
    assert all(s.family is None for s in families._stretches[None])
    made, real = [], Panels.of.__func__

    def counted(cls: type[Panels], *args: Any) -> Panels:
        made.append(args[3].size)
        return real(cls, *args)

    monkeypatch.setattr(Panels, "of", classmethod(counted))
    c = cosines(np.linspace(-1.1, -1.9, 200))
    found = families.panels(c)
    assert sum(made) <= 150
    before = sum(made)
    np.testing.assert_array_equal(found.geometry[:, 0], c)
    again = families.panels(np.concatenate((c[7:90:3], few)))
    assert sum(made) == before
    value = np.bincount(found.row, found.series[:, 0])
    np.testing.assert_allclose(
        np.bincount(again.row, again.series[:, 0])[:28], value[7:90:3], 1e-13
    )


def test_no_family_where_a_kink_was_not_told() -> None:
    """Fresh incidences see that coefficients are not smooth, and rows are had from the model."""
    model = albedo.model("cook_torrance", geometry="smith_rational")
    (part,) = model.parts()
    finest = _finest(part)
    # Without the height at which masking ends, panels do not follow it.
    families = Families(model, part, replace(rings_of(part), levels=None), 1e-8, finest)
    (height,) = part.heights
    y = folded(np.array(height)) + np.linspace(-0.04, 0.04, 100)
    families.panels(cosines(y))
    assert not any(
        s.family for s in families._stretches[None] if s.low < folded(np.array(height)) < s.high
    )


def test_no_family_where_its_rows_could_not_be_better() -> None:
    model = albedo.model("phong", n=20)
    (part,) = model.parts()
    families = Families(model, part, rings_of(part), 3e-13, _finest(part))
    families.panels(cosines(np.linspace(-1.0, -0.5, 100)))
    assert not families._stretches[None]
