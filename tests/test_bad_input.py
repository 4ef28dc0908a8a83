"""Bad input gets one sentence that names what was given and what is allowed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import albedo

WARD = albedo.model("ward")
UP = [0.0, 0.0, 1.0]

BAD: dict[str, tuple[Callable[[], object], str]] = {
    "model": (lambda: albedo.model("wrad"), "did you mean ward.*lambert"),
    "parameter": (lambda: albedo.model("ward", rough=1.0), "no parameter 'rough'; it has alpha_x"),
    "range": (lambda: albedo.model("ward", m=-1.0), r"m = -1 is out of range; .* \[1e-08, 10\]"),
    "NaN": (lambda: albedo.model("phong", n=float("nan")), "n = nan"),
    "infinite": (lambda: albedo.model("phong_original", rho_s=float("inf")), "rho_s = inf"),
    "complex": (lambda: albedo.model("phong", n=1j), "complex"),
    "text": (lambda: albedo.model("phong", n="many"), "'many' is not a number"),
    "array": (lambda: albedo.model("phong", n=[1.0, 2.0]), "is not a number"),
    "choice": (
        lambda: albedo.model("cook_torrance", distribution="ggxx"),
        "choose one of beckmann, ggx",
    ),
    "unused": (
        lambda: albedo.model("cook_torrance", n=3.0),
        "does not use n.* it uses alpha_x, alpha_y",
    ),
    "both": (lambda: albedo.model("ward", m=0.1, alpha_x=0.2), "either m or alpha_x"),
    "cosine": (lambda: albedo.directional_albedo(WARD, 1.5), r"1.5 is out of range.*\[0, 1\]"),
    "negative": (lambda: albedo.directional_albedo(WARD, [-0.1]), r"-0.1 is out of range"),
    "cos NaN": (lambda: albedo.directional_albedo(WARD, np.nan), "nan; every value must be finite"),
    "cos complex": (lambda: albedo.directional_albedo(WARD, 1j), "complex"),
    "broadcast": (
        lambda: albedo.directional_albedo(WARD, [0.1, 0.2], [0.1, 0.2, 0.3]),
        "do not broadcast",
    ),
    "rtol": (lambda: albedo.directional_albedo(WARD, 0.5, rtol=-1.0), r"rtol = -1.0.*\[0, 1\)"),
    "tiny rtol": (lambda: albedo.directional_albedo(WARD, 0.5, rtol=1e-17), "1e-14"),
    "fixed": (lambda: albedo.directional_albedo(WARD, 0.5, fixed="both"), "light or view"),
    "budget": (lambda: albedo.directional_albedo(WARD, 0.5, max_evaluations=3), "at least 16"),
    "not unit": (lambda: WARD.eval([0, 0, 2], UP), "length 2; directions must be unit"),
    "shape": (lambda: WARD.eval([0, 1], UP), r"shape \(2,\); directions have shape \(..., 3\)"),
    "vector NaN": (lambda: WARD.eval([np.nan, 0, 1], UP), "finite"),
    "shapes": (lambda: WARD.eval([UP, UP], [UP, UP, UP]), "do not broadcast"),
    "threads": (lambda: albedo.table(WARD, [0.5], threads=0), r"threads = 0.*\[1, 256\]"),
    "empty sweep": (lambda: albedo.table(WARD, [0.5], sweep={"m": []}), "sweep of m is empty"),
    "sweep": (lambda: albedo.table(WARD, [0.5], sweep={"q": [1.0]}), "no parameter 'q'"),
    "lobe": (lambda: albedo.model_from(lambda a, b: a, lobe="up"), "mirror, half, retro"),
    "no width": (lambda: albedo.model_from(lambda a, b: a, lobe="half"), "needs a width"),
    "no function": (lambda: albedo.model_from(3), "not int"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("name", BAD)
def test_one_sentence_says_what_is_wrong(name: str) -> None:
    call, pattern = BAD[name]
    with pytest.raises(albedo.InputError, match=pattern) as caught:
        call()
    assert "\n" not in str(caught.value)
